"""Speed of list requests: `python -m benchmarks.api [--readers 50] [--requests 2000] [--databases sqlite postgres]`.

The platform has 2,000 sequences and 10,000 jobs of eight owners; the API runs as in the embedded platform (one uvicorn
process, its own command). Readers use keep-alive connections in this process; each sends its next request after the
last answer. Rounds of the lists and of `/healthz` (the floor: a route without a query) alternate, so that other load on
the machine affects all alike. Latencies are measured by the readers; CPU is the API process's own, per request.
"""

import argparse
import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.api_rows import Reader, fill
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.postgres import running_postgres

FLOOR = "/healthz"
PATHS = (FLOOR, "/api/v1/sequences", "/api/v1/jobs", "/api/v1/me")
STARTS_WITHIN_S = 30.0
VACUUM_LOOKS = "1min"  # PostgreSQL's default; the servers of tests have no autovacuum
COLUMNS = ("database", "route", "bytes", "p50 ms", "p99 ms", "a second", "CPU ms", "p50 × floor", "p99 × floor")


@dataclass
class RouteTimes:
    """The measurement of one route: latencies in seconds, and CPU seconds of the API, over all rounds."""

    waited_s: list[float] = field(default_factory=list)
    wall_s: float = 0.0
    cpu_s: float = 0.0
    answer_bytes: int = 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--readers", type=int, default=50)
    parser.add_argument("--requests", type=int, default=2000, help="per route and round")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgres"], choices=["sqlite", "postgres"])
    options = parser.parse_args()
    table = Table(*COLUMNS, title=f"{options.readers} readers at once, pages of 50")
    for kind in options.databases:
        with tempfile.TemporaryDirectory() as folder, database_url(kind) as url:
            for row in measured(Settings(data_folder=Path(folder), database=DatabaseSettings(url)), options):
                table.add_row(kind, *row)
    Console(width=140).print(table)


@contextmanager
def database_url(kind: str) -> Iterator[str]:
    if kind == "sqlite":
        yield ""
        return
    with running_postgres(autovacuum_naptime=VACUUM_LOOKS) as server:
        yield server.url()


def measured(settings: Settings, options: argparse.Namespace) -> Iterator[tuple[str, ...]]:
    upgrade(settings)
    database = Database(settings)
    readers = fill(database, options.readers)
    database.close()
    taken = {path: RouteTimes() for path in PATHS}
    with serving(settings) as (port, pid):
        asyncio.run(ask(port, "/api/v1/me", readers, options.readers * 4))  # warm up
        for _ in range(options.rounds):
            for path in PATHS:
                note(taken[path], port, pid, path, readers, options.requests)
    floor = np.percentile(taken[FLOOR].waited_s, [50, 99])
    for path in PATHS:
        yield shown(path, taken[path], floor)


def note(taken: RouteTimes, port: int, pid: int, path: str, readers: list[Reader], requests: int) -> None:
    cpu_s, begun_s = cpu_of(pid), time.perf_counter()
    waited_s, taken.answer_bytes = asyncio.run(ask(port, path, readers, requests))
    taken.waited_s += waited_s
    taken.wall_s += time.perf_counter() - begun_s
    taken.cpu_s += cpu_of(pid) - cpu_s


def shown(path: str, taken: RouteTimes, floor: np.ndarray) -> tuple[str, ...]:
    p50, p99 = np.percentile(taken.waited_s, [50, 99])
    count = len(taken.waited_s)
    figures = (p50 * 1e3, p99 * 1e3, count / taken.wall_s, taken.cpu_s / count * 1e3)
    texts = [f"{figure:.1f}" for figure in figures[:3]] + [f"{figures[3]:.2f}"]
    return (path, str(taken.answer_bytes), *texts, f"{p50 / floor[0]:.2f}", f"{p99 / floor[1]:.2f}")


@contextmanager
def serving(settings: Settings) -> Iterator[tuple[int, int]]:
    """Yield the port and process id of the API's own process."""
    environment = {
        "STONE_DATA_FOLDER": str(settings.root),
        "STONE_DATABASE__URL": settings.database.url,
        "STONE_BROKER__URL": settings.broker.url,
        "STONE_API__REQUESTS_PER_MINUTE": "100000000",
    }
    with socket.create_server(("127.0.0.1", 0)) as listening, open(settings.root / "api.log", "wb") as log:
        command = [sys.executable, "-m", "services.runtime.embedded.api_process", str(listening.fileno()), "2"]
        descriptors = (listening.fileno(),)
        process = subprocess.Popen(command, env=os.environ | environment, pass_fds=descriptors, stdout=log, stderr=log)
        try:
            yield listening.getsockname()[1], process.pid
        finally:
            process.terminate()
            process.wait(STARTS_WITHIN_S)


async def ask(port: int, path: str, readers: list[Reader], requests: int) -> tuple[list[float], int]:
    """Return the latency of each request in seconds, shared among all readers, and the bytes of an answer."""
    waited_s: list[float] = []
    left = iter(range(requests))
    sizes = await asyncio.gather(*(read(port, path, reader, left, waited_s) for reader in readers))
    return waited_s, max(sizes)


async def read(port: int, path: str, reader: Reader, left: Iterator[int], waited_s: list[float]) -> int:
    """Send requests on one connection until none is left; return the bytes of the last answer."""
    incoming, outgoing = await asyncio.open_connection("127.0.0.1", port)
    request = f"GET {path} HTTP/1.1\r\nHost: api\r\nAuthorization: Bearer {reader.secret}\r\n\r\n".encode()
    size = 0
    for _ in left:
        begun_s = time.perf_counter()
        outgoing.write(request)
        head = await incoming.readuntil(b"\r\n\r\n")
        size = int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
        await incoming.readexactly(size)
        waited_s.append(time.perf_counter() - begun_s)
        if not head.startswith(b"HTTP/1.1 200"):
            raise RuntimeError(f"{path}: {head.decode()}")
    outgoing.close()
    return size


def cpu_of(pid: int) -> float:
    """Return the CPU seconds of the process, all its threads (Linux)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


if __name__ == "__main__":
    main()
