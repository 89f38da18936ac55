"""Markdown tables with escaped cells."""

import re
from collections.abc import Iterable, Sequence

CODE = re.compile(r"(`[^`]+`)")


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table; cells are Markdown, of one line. Without a row the empty text."""
    lines = [f"| {' | '.join(map(cell, row))} |" for row in rows]
    if not lines:
        return ""
    return "\n".join([f"| {' | '.join(head)} |", "|" + "---|" * len(head), *lines]) + "\n"


def cell(text: str) -> str:
    """Text on one line whose bars do not end the cell."""
    return " ".join(text.split()).replace("|", "\\|")


def code(text: object) -> str:
    """Text as it is typed; the empty text for the empty one."""
    said = " ".join(str(text).split())
    fence = "``" if "`" in said else "`"
    return f"{fence}{said}{fence}" if said else ""


def plain(text: str) -> str:
    """Text of which Markdown makes nothing but text; what stands between backticks stays code."""
    return "".join(part if part.startswith("`") else _escaped(part) for part in CODE.split(text))


def _escaped(text: str) -> str:
    for mark in ("\\", "<", "*", "_", "[", "]"):
        text = text.replace(mark, "&lt;" if mark == "<" else f"\\{mark}")
    return text
