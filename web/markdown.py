"""The little of Markdown that our own definitions are written in, as values: a template escapes and draws them.

**Conventions.** Headings, paragraphs, lists of `-`, blocks indented by four, `*emphasis*` and `` `code` ``; whatever
else stands there is text. No link, no HTML, no nesting: nothing of a text can become more than what is listed here.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Literal

Kind = Literal["heading", "paragraph", "list", "code"]
SpanKind = Literal["text", "emphasis", "code"]
_SPAN = re.compile(r"`([^`]+)`|\*([^*\s][^*]*)\*")
_HEADING = re.compile(r"(#{1,4}) +(.+)")
_INDENT = "    "


@dataclass(frozen=True)
class Span:
    kind: SpanKind
    text: str


@dataclass(frozen=True)
class Block:
    """`items` are the lines of a list, one of everything else; `level` is that of a heading, from 1."""

    kind: Kind
    items: tuple[tuple[Span, ...], ...]
    level: int = 0


def blocks(text: str) -> tuple[Block, ...]:
    """The blocks of a text, which blank lines part."""
    parts = (
        list(lines) for is_said, lines in groupby(text.splitlines(), key=lambda line: bool(line.strip())) if is_said
    )
    return tuple(_block(lines) for lines in parts)


def spans(line: str) -> tuple[Span, ...]:
    """The stretches of a line."""
    return tuple(_spans(line))


def _block(lines: list[str]) -> Block:
    heading = _HEADING.fullmatch(lines[0]) if len(lines) == 1 else None
    if heading:
        return Block("heading", (spans(heading[2]),), len(heading[1]))
    if all(line.startswith(_INDENT) for line in lines):
        return Block("code", ((Span("code", "\n".join(line[len(_INDENT) :] for line in lines)),),))
    if lines[0].startswith("- "):
        return Block("list", tuple(spans(item) for item in _items(lines)))
    return Block("paragraph", (spans(" ".join(line.strip() for line in lines)),))


def _items(lines: list[str]) -> list[str]:
    """The items of a list; a line without a dash goes on with the item before."""
    items: list[str] = []
    for line in lines:
        if line.startswith("- "):
            items.append(line[2:].strip())
        else:
            items[-1] += f" {line.strip()}"
    return items


def _spans(line: str) -> Iterator[Span]:
    end = 0
    for found in _SPAN.finditer(line):
        if found.start() > end:
            yield Span("text", line[end : found.start()])
        yield Span("code", found[1]) if found[1] else Span("emphasis", found[2])
        end = found.end()
    if end < len(line):
        yield Span("text", line[end:])
