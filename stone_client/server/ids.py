"""Ids as commands take them: whole, as six or more digits of their beginning or end, or by age (latest, latest~1, …).

**Conventions.** An id is 32 hex digits: 12 of time, 4 of a counter, 16 random. Things of one afternoon share their
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
    found = LATEST.fullmatch(named)
    return None if found is None else int(found[1] or 0)


def whole_id(short: str, ids: Iterable[str]) -> str | None:
    """Return the one of the ids that begins or ends so; None if there is none. Raises `ambiguous_id`."""
    if not is_short_id(short):
        return None
    found = sorted({one for one in ids if one.startswith(short) or one.endswith(short)})
    if len(found) > 1:
        named = ", ".join(found[:MOST_CANDIDATES]) + (", …" if len(found) > MOST_CANDIDATES else "")
        raise Refused("ambiguous_id", f"{short!r} matches {len(found)} ids; give more digits: {named}")
    return found[0] if found else None


def chosen_id(named: str, ids: Sequence[str]) -> str | None:
    """Return the id of `ids`, newest first, that is named by age or by a short id. Raises `ambiguous_id`."""
    place = place_from_newest(named)
    if place is None:
        return whole_id(named, ids)
    return ids[place] if place < len(ids) else None
