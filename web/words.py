"""Template filters and tests: values formatted for people.

**Conventions.** Nothing is null to a reader: what is not known is a dash. Ratios are written in percent, bytes in
powers of 1000 as disks are sold, durations in the two largest units.
"""

from collections.abc import Callable, Iterable, Mapping
from datetime import datetime, tzinfo
from typing import Any

from services.runtime.jobs.queries import title_of
from stone_base.codes.catalogue import harm_rank
from stone_base.counts import counted
from web.colours import coloured
from web.state_words import state_word
from web.zones import written

DASH = "–"
UNITS = ("B", "kB", "MB", "GB", "TB", "PB")
SPANS = (("d", 86_400), ("h", 3600), ("min", 60), ("s", 1))


def size(n_bytes: float | None) -> str:
    """`2.5 GB`."""
    if n_bytes is None:
        return DASH
    value, unit = float(n_bytes), 0
    while abs(value) >= 999.5 and unit < len(UNITS) - 1:
        value, unit = value / 1000, unit + 1
    return f"{value:.0f} {UNITS[unit]}" if unit == 0 or value >= 99.5 else f"{value:.1f} {UNITS[unit]}"


def span(seconds: float | None) -> str:
    """`2 h 5 min`; below ten seconds with a decimal."""
    if seconds is None:
        return DASH
    if seconds < 10:
        return f"{seconds:.1f} s"
    left, said = round(seconds), list[str]()
    for name, length in SPANS:
        count, rest = divmod(left, length)
        if count or said:
            said.append(f"{count} {name}" if count else "")
            left = rest
        if len(said) == 2:
            break
    return " ".join(part for part in said if part)


def about(seconds: float | None) -> str:
    """An estimate that was rounded where it was made: `about 40 s`, `about 2 min`."""
    return "not known yet" if seconds is None else f"about {span(seconds).replace('.0 s', ' s')}"


def distance(metres: float | None) -> str:
    """`1.82 km`; below a kilometre in metres."""
    if metres is None:
        return DASH
    return f"{metres:.0f} m" if metres < 999.5 else f"{metres / 1000:.2f} km"


def percent(ratio: float | None, digits: int = 1) -> str:
    """`29.1 %`."""
    return DASH if ratio is None else f"{100 * ratio:.{digits}f} %"


def number(value: float | None) -> str:
    """`12,345`."""
    if value is None:
        return DASH
    return f"{value:,}" if isinstance(value, int) else f"{value:,.2f}"


def moment(value: datetime | None, zone: tzinfo) -> str:
    """The time in the reader's zone."""
    return DASH if value is None else written(value, zone)


def iso(value: datetime) -> str:
    """The time as `datetime` of a `<time>`."""
    return value.isoformat().replace("+00:00", "Z")


def spoken(code: str) -> str:
    """A code as words: `worker_lost` → `worker lost`."""
    return code.replace("_", " ")


def short(identity: str | None) -> str:
    """The end of an id, which differs between things made one after the other."""
    return DASH if not identity else identity[-8:]


def by_harm(findings: Iterable[Any]) -> list[Any]:
    """Findings, mappings or values, with the most harm to labels first; those of equal harm stay in their order."""

    def rank(one: Any) -> tuple[int, int]:
        code, severity = (one["code"], one["severity"]) if isinstance(one, Mapping) else (one.code, one.severity)
        return harm_rank(code, severity)

    return sorted(findings, key=rank)


FILTERS: Mapping[str, Callable[..., Any]] = {
    "size": size,
    "span": span,
    "about": about,
    "percent": percent,
    "distance": distance,
    "number": number,
    "moment": moment,
    "iso": iso,
    "spoken": spoken,
    "short": short,
    "state_word": state_word,
    "job_title": title_of,
    "by_harm": by_harm,
    "coloured": coloured,
    "counted": counted,
}
TESTS: Mapping[str, Callable[..., bool]] = {}
