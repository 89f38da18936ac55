"""Markdown as HTML, by markdown-it-py: CommonMark in which HTML stays text, without links and without pictures.

**Conventions.** For the definitions of metrics. Their title is left out, since the page has its own. Nothing of a text
leads or loads anywhere, and only formulas (blocks of code) bear attributes.
"""

from collections.abc import Sequence
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.common.utils import escapeHtml
from markdown_it.renderer import RendererHTML
from markdown_it.token import Token
from markupsafe import Markup


def _formula(_: RendererHTML, tokens: Sequence[Token], place: int, *__: Any) -> str:
    """Return a formula as a focusable block, so that a wide block can be scrolled by keyboard."""
    return f'<pre tabindex="0" role="region" aria-label="Formula">{escapeHtml(tokens[place].content)}</pre>\n'


_MARKDOWN = MarkdownIt("commonmark", {"html": False}).disable(["autolink", "image", "link", "reference"])
_MARKDOWN.add_render_rule("code_block", _formula)
_MARKDOWN.add_render_rule("fence", _formula)


def html_of(text: str) -> Markup:
    """Return the HTML below the title."""
    tokens = _MARKDOWN.parse(text)
    has_title = bool(tokens) and tokens[0].tag == "h1"
    rendered: str = _MARKDOWN.renderer.render(tokens[3:] if has_title else tokens, _MARKDOWN.options, {})
    return Markup(rendered)
