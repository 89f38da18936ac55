"""The reader's time zone, from the page's script.

**Conventions.** The cookie holds a name of the IANA database; anything else counts as none.
"""

from datetime import UTC, datetime, tzinfo
from functools import cache
from zoneinfo import ZoneInfo, available_timezones

from fastapi import Request

COOKIE = "stone_zone"


@cache
def _names() -> frozenset[str]:
    return frozenset(available_timezones())


def zone_of(request: Request) -> tzinfo:
    """Return the reader's time zone, or UTC if unknown."""
    name = request.cookies.get(COOKIE, "")
    return ZoneInfo(name) if name in _names() else UTC


def written(moment: datetime, zone: tzinfo, *, is_exact: bool = False) -> str:
    """Return `2026-11-21 20:10` in this zone; in UTC with its name, because the reader's zone is unknown."""
    text = moment.astimezone(zone).strftime("%Y-%m-%d %H:%M:%S" if is_exact else "%Y-%m-%d %H:%M")
    return f"{text} UTC" if zone is UTC else text
