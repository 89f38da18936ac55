"""HTML out of values: every text passes through `text`, so that a topic's name is never markup.

**Conventions.** Functions take plain text and return HTML. Names come from recordings and are hostile: control and
direction characters are spelled out, long ones lose their middle, and each stands in a `<bdi>` of its own.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape

LONGEST_NAME, LONGEST_SENTENCE = 80, 600
DASH = "–"


@dataclass(frozen=True)
class Table:
    """`columns` head it; the first cell of a row heads the row, `numeric` columns (by place) are right-aligned.

    Cells are HTML already.
    """

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numeric: frozenset[int] = frozenset()


def plain(words: str, longest: int) -> str:
    """One line that sends nothing: what does not print is spelled out, what is too long loses its middle."""
    if len(words) > longest:
        words = f"{words[: longest // 2]}…{words[-(longest // 2) :]}"
    return "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in words)


def text(words: str, longest: int = LONGEST_SENTENCE) -> str:
    """Somebody's words as HTML text or attribute value."""
    return escape(plain(words, longest), quote=True)


def name(words: str) -> str:
    """A topic's or file's name."""
    return f'<bdi class="name">{text(words, LONGEST_NAME)}</bdi>'


def number(value: float | int | None, digits: int = 1) -> str:
    """With thousands apart; a dash for None."""
    if value is None:
        return DASH
    return f"{round(value, digits) + 0.0:,.{digits}f}".replace(",", "\u202f")


def percent(ratio: float | None, digits: int = 1) -> str:
    return DASH if ratio is None else f"{100 * ratio:.{digits}f} %"


def table(values: Table) -> str:
    """In a box that scrolls sideways by itself, also by keyboard."""
    head = "".join(
        f'<th scope="col"{_aligned(place, values)}>{text(column)}</th>' for place, column in enumerate(values.columns)
    )
    body = "".join(f"<tr>{_cells(row, values)}</tr>" for row in values.rows)
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="{text(values.caption)}"><table>'
        f"<caption>{text(values.caption)}</caption><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def details(summary: str, content: str) -> str:
    return f"<details><summary>{text(summary)}</summary>{content}</details>"


def figure(title: str, picture: str, told: str, below: str = "") -> str:
    """A picture (HTML) with what it shows in words; `below` is HTML under the caption."""
    return (
        f'<figure><h3>{text(title)}</h3><div class="plot" role="img" aria-label="{text(f"{title}: {told}")}">'
        f"{picture}</div><figcaption>{text(told)}</figcaption>{below}</figure>"
    )


def section(anchor: str, title: str, content: Iterable[str]) -> str:
    """Nothing where there is nothing to say."""
    said = "".join(content)
    if not said:
        return ""
    heading = f'<h2 id="{anchor}-title">{title}</h2>'
    return f'<section id="{anchor}" aria-labelledby="{anchor}-title">{heading}{said}</section>'


def legend(entries: Sequence[tuple[str, str]]) -> str:
    """(class of the swatch, HTML) of every line or colour in a picture."""
    listed = "".join(f'<li><i class="swatch {swatch}"></i>{label}</li>' for swatch, label in entries)
    return f'<ul class="legend">{listed}</ul>'


def _aligned(place: int, values: Table) -> str:
    return ' class="n"' if place in values.numeric else ""


def _cells(row: Sequence[str], values: Table) -> str:
    first = f'<th scope="row"{_aligned(0, values)}>{row[0]}</th>'
    return first + "".join(f"<td{_aligned(place, values)}>{cell}</td>" for place, cell in enumerate(row[1:], start=1))
