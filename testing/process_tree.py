"""Processes of a worker: its pool, its fork server, and the server's sandboxed children."""

from contextlib import suppress
from pathlib import Path

from testing.process_states import GONE, children_of


def fork_servers_of(worker: int) -> list[int]:
    """Return the fork servers of a worker and of each pool process that started another."""
    near = children_of(worker)
    return [
        pid for pid in (*near, *(child for parent in near for child in children_of(parent))) if _is_fork_server(pid)
    ]


def sandboxed_children_of(worker: int) -> list[int]:
    """Return its current sandboxed children, at work or idle until their run's next job."""
    return [child for server in fork_servers_of(worker) for child in children_of(server)]


def _is_fork_server(pid: int) -> bool:
    with suppress(*GONE):
        return b"sandbox.fork_server" in Path(f"/proc/{pid}/cmdline").read_bytes()
    return False
