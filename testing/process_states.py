"""Other processes as the kernel tells of them (proc(5)): whether one runs, whose child it is, and its children."""

from contextlib import suppress
from pathlib import Path

GONE = (FileNotFoundError, ProcessLookupError)


def is_running(pid: int) -> bool:
    """Whether the process runs; one that ended and waits for its parent does not."""
    with suppress(*GONE):
        return _after_name(pid)[0] != "Z"
    return False


def parent_of(pid: int) -> int:
    """Raises `FileNotFoundError` where the process has ended."""
    return int(_after_name(pid)[1])


def children_of(pid: int) -> list[int]:
    """The children that its threads have; none when it has ended."""
    with suppress(*GONE):
        tasks = Path(f"/proc/{pid}/task").glob("*/children")
        return [int(child) for task in tasks for child in task.read_text().split()]
    return []


def _after_name(pid: int) -> list[str]:
    """State, parent and so on; a name may hold anything, brackets too."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
