"""Log files of the child processes, truncated by size by the supervisor.

**Conventions.** Cutting is copy and truncate: the child goes on writing to the same open file (`O_APPEND`), so it needs
no signal and no pipe that could fill up. A line written between the two may be lost; job logs are in the database.
"""

import shutil
from pathlib import Path

MAX_BYTES = 16 * 2**20
KEPT = 3


def cut_if_large(log: Path, max_bytes: int = MAX_BYTES) -> bool:
    """Move what is in `log` to `<log>.1` when it is larger than `max_bytes`; older ones move up, the oldest goes."""
    if not log.exists() or log.stat().st_size <= max_bytes:
        return False
    for number in range(KEPT - 1, 0, -1):
        older = _numbered(log, number)
        if older.exists():
            older.replace(_numbered(log, number + 1))
    shutil.copyfile(log, _numbered(log, 1))
    with log.open("r+b") as file:
        file.truncate(0)
    return True


def last_words(log: Path, max_bytes: int = 2000) -> str:
    """The last line of `log` that is not empty; empty where it says nothing."""
    if not log.exists():
        return ""
    with log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - max_bytes))
        lines = file.read().decode("utf-8", "replace").splitlines()
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _numbered(log: Path, number: int) -> Path:
    return log.with_name(f"{log.name}.{number}")
