"""Ids of commands: whole, as six or more digits of their beginning or end, or by age (latest, latest~1, …).

**Conventions.** An id is 32 hex digits: 12 of time, 4 of a counter, 16 random. Ids created within hours share their
beginning, so their ends are accepted too. An ambiguous short id is refused with its candidates.
"""

import re
from collections.abc import Iterable, Sequence

from stone_base.errors import Refused

ID, SHORT, LATEST = re.compile("[0-9a-f]{32}"), re.compile("[0-9a-f]{6,31}"), re.compile(r"latest(?:~(\d{1,4}))?")
MOST_CANDIDATES = 6


def is_id(named: str) -> bool:
    return ID.fullmatch(named) is not None


def is_short_id(named: str) -> bool:
    return SHORT.fullmatch(named) is not None


def place_from_newest(named: str) -> int | None:
    """Return 0 for `latest`, 1 for `latest~1`, …; None for any other text."""
    match = LATEST.fullmatch(named)
    return None if match is None else int(match[1] or 0)


def whole_id(short: str, ids: Iterable[str]) -> str | None:
    """Return the id that begins or ends with `short`; None if there is none. Raises `ambiguous_id`."""
    if not is_short_id(short):
        return None
    matching = sorted({whole for whole in ids if whole.startswith(short) or whole.endswith(short)})
    if len(matching) > 1:
        named = ", ".join(matching[:MOST_CANDIDATES]) + (", …" if len(matching) > MOST_CANDIDATES else "")
        raise Refused("ambiguous_id", f"{short!r} matches {len(matching)} ids; give more digits: {named}")
    return matching[0] if matching else None


def chosen_id(named: str, ids: Sequence[str]) -> str | None:
    """Return the id from `ids`, newest first, selected by age or by a short id. Raises `ambiguous_id`."""
    index = place_from_newest(named)
    if index is None:
        return whole_id(named, ids)
    return ids[index] if index < len(ids) else None
