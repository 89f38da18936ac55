"""The templates of the quality page: they escape everything, so that a topic's name is never markup.

**Conventions.** Names come from recordings and are hostile: control and direction characters are spelled out, long
names lose their middle, and each stands in a `<bdi>` of its own. All output of a template passes through `plain`, even
if the template does not call it.
"""

from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape

from stone_base.codes.catalogue import CATALOGUE, harm_of
from stone_base.codes.meaning import HARM_WORDS

LONGEST_NAME, LONGEST_SENTENCE = 80, 600
DASH = "–"
TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class HtmlTable:
    """`columns` are the headings; the first cell of a row is its heading, `numeric` columns (by index) are
    right-aligned.

    Cells are text, or HTML if they are `Markup`.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: frozenset[int] = frozenset()


@dataclass(frozen=True)
class DrawnFigure:
    """A picture (SVG or `<img>`) with a caption; `legend` is (class of the swatch, label) of its lines."""

    title: str
    picture: Markup
    told: str
    legend: tuple[tuple[str, str], ...] = ()
    table: HtmlTable | None = None


def plain(words: str, longest: int) -> str:
    """Return one harmless line: unprintable characters are spelled out, a long text loses its middle."""
    if len(words) > longest:
        words = f"{words[: longest // 2]}…{words[-(longest // 2) :]}"
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in words)


def text(words: str, longest: int = LONGEST_SENTENCE) -> Markup:
    """Return a foreign text as HTML text or attribute value."""
    return escape(plain(words, longest))


def name(words: str) -> Markup:
    """Return a topic's or file's name as HTML."""
    return Markup('<bdi class="name">{}</bdi>').format(text(words, LONGEST_NAME))


def number(value: float | int | None, digits: int = 1) -> Markup:
    """Return a number with thin spaces between thousands, which `plain` would spell out; a dash for None."""
    if value is None:
        return Markup(DASH)
    return Markup(f"{round(value, digits) + 0.0:,.{digits}f}".replace(",", "\u202f"))


def percent(ratio: float | None, digits: int = 1) -> str:
    return DASH if ratio is None else f"{100 * ratio:.{digits}f} %"


def rendered(template: str, **values: object) -> str:
    """Return the template with the values in it."""
    return _TEMPLATES.get_template(template).render(**values)


def _said(value: object) -> object:
    """Return the safe form of an expression's value in a template."""
    return plain(value, LONGEST_SENTENCE) if isinstance(value, str) and not isinstance(value, Markup) else value


_TEMPLATES = Environment(
    loader=FileSystemLoader(TEMPLATES),
    autoescape=True,
    undefined=StrictUndefined,
    finalize=_said,
    trim_blocks=True,
    lstrip_blocks=True,
)
_TEMPLATES.globals |= {"meaning_of": CATALOGUE.get, "harm_of": harm_of, "harm_words": HARM_WORDS}
_TEMPLATES.filters |= {"name": name, "number": number, "percent": percent}
