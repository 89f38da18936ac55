"""Markdown tables with escaped cells."""

import re
from collections.abc import Iterable, Sequence

CODE = re.compile(r"(`[^`]+`)")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of one-line Markdown cells, or the empty text without rows."""
    lines = [f"| {' | '.join(map(cell, row))} |" for row in rows]
    if not lines:
        return ""
    return "\n".join([f"| {' | '.join(head)} |", "|" + "---|" * len(head), *lines]) + "\n"


def cell(text: str) -> str:
    """Return the text on one line with escaped bars."""
    return " ".join(text.split()).replace("|", "\\|")


def code(text: object) -> str:
    """Return the text as code, or the empty text."""
    words = " ".join(str(text).split())
    fence = "``" if "`" in words else "`"
    return f"{fence}{words}{fence}" if words else ""


def plain(text: str) -> str:
    """Return the text with Markdown escaped, except between backticks."""
    return "".join(part if part.startswith("`") else _escaped(part) for part in CODE.split(text))


def _escaped(text: str) -> str:
    for mark in ("\\", "<", "*", "_", "[", "]"):
        text = text.replace(mark, "&lt;" if mark == "<" else f"\\{mark}")
    return text
