"""States of other processes, from the kernel (proc(5)): whether one runs, its parent, and its children."""

from contextlib import suppress
from pathlib import Path

GONE = (FileNotFoundError, ProcessLookupError)


def is_running(pid: int) -> bool:
    """Return whether the process runs; a zombie does not."""
    with suppress(*GONE):
        return _after_name(pid)[0] != "Z"
    return False


def parent_of(pid: int) -> int:
    """Return the parent. Raises `FileNotFoundError` if the process has ended."""
    return int(_after_name(pid)[1])


def children_of(pid: int) -> list[int]:
    """Return the children of its threads; empty if it has ended."""
    with suppress(*GONE):
        tasks = Path(f"/proc/{pid}/task").glob("*/children")
        return [int(child) for task in tasks for child in task.read_text().split()]
    return []


def _after_name(pid: int) -> list[str]:
    """Return state, parent and further fields; the name before them may contain any characters, also brackets."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
