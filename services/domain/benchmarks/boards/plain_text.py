"""Escaping of untrusted text for CSV, Markdown and LaTeX.

**Conventions.** What is not printable is shown escaped first (`one_line`), so nothing spans lines. CSV: a spreadsheet
runs a cell that begins with = + - @, also behind a separator that it splits at by itself, so an apostrophe stands
before it (OWASP, CSV injection). Markdown: HTML and links are spelled out by references, all other punctuation by
backslashes (CommonMark 0.31 §2.4, §2.5). LaTeX: no character keeps a category but letter, digit, space and other.
"""

import re

from stone.errors import one_line

FORMULA = re.compile(r"(^|[;,\t|])(\s*)([=+\-@\uff1d\uff0b\uff0d\uff20])")
MARKDOWN = {character: f"\\{character}" for character in "\\`*_{}[]()#+-.!|~"} | {
    character: f"&#{ord(character)};" for character in "&<>:@/$^=\"'"
}
LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"{\char34}",
    "`": "{`}",
    "[": "{[}",
    "]": "{]}",
    "*": "{*}",
}


def csv_text(text: str) -> str:
    """The text as a cell that no spreadsheet computes; quoting is the writer's."""
    return FORMULA.sub(r"\1\2'\3", one_line(text))


def markdown_text(text: str) -> str:
    """The text as it is read, in a cell of a table."""
    return "".join(MARKDOWN.get(character, character) for character in one_line(text))


def latex_text(text: str) -> str:
    """The text as it is typeset, by LaTeX without any package."""
    return "".join(LATEX.get(character, character) for character in one_line(text))
