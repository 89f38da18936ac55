"""Names of things by age, as commands take them beside ids: latest, latest~1, …"""

import re

ID, LATEST = re.compile("[0-9a-f]{32}"), re.compile(r"latest(?:~(\d{1,4}))?")


def is_id(named: str) -> bool:
    return ID.fullmatch(named) is not None


def place_from_newest(named: str) -> int | None:
    """0 for `latest`, 1 for `latest~1`, …; None for anything else."""
    found = LATEST.fullmatch(named)
    return None if found is None else int(found[1] or 0)
