"""Two machines simulated as Linux network namespaces, with a link that can be cut and slowed.

**Conventions.** It requires Linux and root. A thread enters a namespace, and its child processes stay there; other
threads are unaffected. The link is a veth pair; both ends are shaped alike, so a rate applies in both directions. A cut
link drops every packet silently, as a pulled cable does. Nothing outside the namespaces changes.
"""

import ctypes
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

CLONE_NEWNET = 0x40000000
QUEUE_MS = 400
NOBODY = "02:00:00:00:00:ff"
_LIBC = ctypes.CDLL(None, use_errno=True)


@dataclass(frozen=True)
class Space:
    """A namespace: its name, its end of the link, its address on it."""

    name: str
    interface: str
    address: str

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Move this thread, and the processes it starts, to that machine during the block."""
        before = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        there = os.open(f"/run/netns/{self.name}", os.O_RDONLY)
        try:
            _enter(there)
            yield
        finally:
            _enter(before)
            os.close(there)
            os.close(before)


@dataclass(frozen=True)
class Link:
    """The link between two namespaces."""

    ends: tuple[Space, Space]

    def cut(self) -> None:
        """Send the packets of both ends to a missing station, which needs no kernel module (netem is often missing)."""
        for end, other in self._both_ways():
            where = ("neigh", "replace", other.address, "lladdr", NOBODY, "dev", end.interface, "nud", "permanent")
            _run("ip", "-n", end.name, *where)

    def slow(self, bytes_per_s: int) -> None:
        how = ("tbf", "rate", f"{bytes_per_s * 8}bit", "burst", "32kb", "latency", f"{QUEUE_MS}ms")
        for end in self.ends:
            _run("ip", "netns", "exec", end.name, "tc", "qdisc", "replace", "dev", end.interface, "root", *how)

    def mend(self) -> None:
        for end, other in self._both_ways():
            _run("ip", "-n", end.name, "neigh", "del", other.address, "dev", end.interface, check=False)
            _run("ip", "netns", "exec", end.name, "tc", "qdisc", "del", "dev", end.interface, "root", check=False)

    def _both_ways(self) -> tuple[tuple[Space, Space], tuple[Space, Space]]:
        first, second = self.ends
        return (first, second), (second, first)


def why_not() -> str:
    """Return why namespaces are unavailable here; empty if they are available."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    if missing := [tool for tool in ("ip", "tc") if shutil.which(tool) is None]:
        return f"{' and '.join(missing)} (iproute2) is not on PATH"
    name = f"stone-try-{os.getpid()}"
    tried = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    _run("ip", "netns", "del", name, check=False)
    return tried.stderr.strip()


@contextmanager
def two_machines() -> Iterator[Link]:
    """Yield two namespaces and a link between them; delete all of it at the end."""
    number = os.getpid() % 10**5
    spaces = tuple(
        Space(f"stone-{number}-{side}", f"stone{number}{side}", f"10.77.0.{host}") for host, side in enumerate("ab", 1)
    )
    try:
        for space in spaces:
            _run("ip", "netns", "add", space.name)
        first, second = spaces
        _run("ip", "link", "add", first.interface, "type", "veth", "peer", "name", second.interface)
        for space in spaces:
            _run("ip", "link", "set", space.interface, "netns", space.name)
            _run("ip", "-n", space.name, "addr", "add", f"{space.address}/24", "dev", space.interface)
            for interface in ("lo", space.interface):
                _run("ip", "-n", space.name, "link", "set", interface, "up")
        yield Link((first, second))
    finally:
        for space in spaces:
            _run("ip", "netns", "del", space.name, check=False)


def _enter(descriptor: int) -> None:
    if _LIBC.setns(descriptor, CLONE_NEWNET):
        raise OSError(ctypes.get_errno(), "setns")


def _run(*words: str, check: bool = True) -> None:
    subprocess.run(words, check=check, capture_output=True)
