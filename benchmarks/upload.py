"""Uploads through a real uvicorn, and plain writes of the same bytes: `python -m benchmarks.upload [--place …]`.

Both read the same file from the page cache and write to the same disk. They end when the bytes are on it (fsync; the
upload also has its sha256 by then). They take turns in one run. The client is one process that sends one PATCH by
`sendfile`, at the minimum cost of a client; the API's memory and processor time come from the kernel. Places are the
uploads folder, the store as a folder, and the store as a real S3 server on this machine. The server shares the
machine's cores and answers before its disk has the bytes.
"""

import argparse
import hashlib
import os
import socket
import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import httpx
from rich.console import Console
from rich.table import Table

from services.runtime.access import tokens, users
from services.runtime.database.migrate import upgrade
from services.runtime.platform import Platform, open_platform
from services.runtime.settings import Settings, UploadSettings
from services.runtime.store.garbage_collection import collect_garbage
from testing.api.process import ApiProcess, running_api
from testing.api.serving import Person
from testing.api.tus import TUS, checksum, created, shown
from testing.servers.s3 import running_s3

MIB = 1 << 20
PLAIN = "plain write + fsync"
WAYS = ("one PATCH", "one PATCH, sha256 declared", "PATCHes of 16 MiB, sha256 of each and of the whole")


@dataclass
class UploadTimes:
    """The cost of each turn of one way."""

    wall_s: list[float] = field(default_factory=list)
    processor_s: list[float] = field(default_factory=list)

    @property
    def median_s(self) -> float:
        return statistics.median(self.wall_s)


@dataclass(frozen=True)
class Bench:
    """The source file, the running API, and its client."""

    source: Path
    sha256: str
    process: ApiProcess
    owner: Person
    platform: Platform

    @property
    def size_bytes(self) -> int:
        return self.source.stat().st_size

    def write_plainly(self) -> None:
        """Write the file directly."""
        target = self.platform.settings.uploads_folder / "plain"
        with self.source.open("rb") as source, target.open("wb") as file:
            while block := source.read(MIB):
                file.write(block)
            file.flush()
            os.fsync(file.fileno())
        target.unlink()

    def upload(self, way: str) -> None:
        declared = {"sha256": self.sha256} if "sha256" in way else {}
        piece_bytes = 16 * MIB if "16 MiB" in way else self.size_bytes
        with httpx.Client(base_url=self.process.url, timeout=300) as api:
            where = created(api, self.owner, self.size_bytes, **declared)
            with socket.create_connection(("127.0.0.1", self.process.port)) as connection:
                for offset in range(0, self.size_bytes, piece_bytes):
                    self._send(connection, where, offset, min(piece_bytes, self.size_bytes - offset))
            if shown(api, self.owner, where)["sha256"] != self.sha256:
                raise SystemExit("the upload differs from its file: the benchmark is void")
            api.delete(where, headers={**TUS, **self.owner.headers})

    def _send(self, connection: socket.socket, where: str, offset: int, count: int) -> None:
        head = f"PATCH {where} HTTP/1.1\r\nHost: localhost\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: {offset}\r\n"
        head += f"Content-Type: application/offset+octet-stream\r\nAuthorization: Bearer {self.owner.secret}\r\n"
        with self.source.open("rb") as source:
            if count < self.size_bytes:
                source.seek(offset)
                head += f"Upload-Checksum: {checksum(source.read(count), 'sha256')}\r\n"
            connection.sendall(f"{head}Content-Length: {count}\r\n\r\n".encode())
            connection.sendfile(source, offset, count)
        answer = b""
        while b"\r\n\r\n" not in answer:
            answer += connection.recv(4096) or b"\r\n\r\n"
        if b" 204 " not in answer.split(b"\r\n")[0]:
            raise SystemExit(answer.decode())


def compare(bench: Bench, turns: int) -> dict[str, UploadTimes]:
    """Run every way in turn, `turns` times; the first round only warms up."""
    clocks: dict[str, UploadTimes] = {}
    for turn in range(turns + 1):
        if turn == 1:
            clocks = {}
        for way in (PLAIN, *WAYS):
            clock = clocks.setdefault(way, UploadTimes())
            processor = time.process_time if way == PLAIN else bench.process.processor_s
            spent_s, begun_s = processor(), time.perf_counter()
            bench.write_plainly() if way == PLAIN else bench.upload(way)
            clock.wall_s.append(time.perf_counter() - begun_s)
            clock.processor_s.append(processor() - spent_s)
            collect_garbage(bench.platform)  # otherwise the store's content fills the disk
    return clocks


def make_owner(platform: Platform) -> Person:
    with platform.database.transaction() as session:
        user = users.create_user(session, "bench", "curator")
        return Person(user.id, user.name, tokens.issue(session, user, "bench", ["upload", "read"], 3600.0))


def make_source(path: Path, size_bytes: int) -> str:
    """Write random bytes; return their sha256."""
    whole, block = hashlib.sha256(), os.urandom(min(size_bytes, 64 * MIB))
    with path.open("wb") as file:
        for number in range(-(-size_bytes // len(block))):
            piece = number.to_bytes(8, "little") + block[8 : min(len(block), size_bytes - number * len(block))]
            file.write(piece)
            whole.update(piece)
        file.flush()
        os.fsync(file.fileno())
    return whole.hexdigest()


def table_of(clocks: dict[str, UploadTimes], size_bytes: int) -> Table:
    table = Table(title=f"{size_bytes / 2**30:.3g} GiB, medians of {len(clocks[PLAIN].wall_s)} turns")
    for column in ("way", "MB/s", "of plain", "slowest turn, of plain's", "processor s"):
        table.add_column(column, justify="left" if column == "way" else "right")
    for way, clock in clocks.items():
        table.add_row(
            way,
            f"{size_bytes / clock.median_s / 1e6:.0f}",
            f"{clocks[PLAIN].median_s / clock.median_s:.2f} x",
            f"{max(clocks[PLAIN].wall_s) / max(clock.wall_s):.2f} x",
            f"{statistics.median(clock.processor_s):.2f}",
        )
    return table


@contextmanager
def upload_rig(target: str) -> Iterator[dict[str, Any]]:
    """Yield the settings of the target, by group."""
    in_store = {"uploads": UploadSettings(backend="store")}
    if target == "s3":
        with running_s3() as server:
            yield {**in_store, "store": server.settings()}
    else:
        yield in_store if target == "store" else {}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--mib", type=int, default=1024)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--folder", type=Path, default=None, help="folder to write to (default: a temporary folder)")
    parser.add_argument("--place", choices=["folder", "store", "s3"], default="folder", help="where uploads lie")
    chosen = parser.parse_args()
    with TemporaryDirectory(prefix="stone-bench-", dir=chosen.folder) as name, upload_rig(chosen.place) as groups:
        folder = Path(name)
        settings = Settings(data_folder=folder / "data", **groups)
        upgrade(settings)
        platform = open_platform(settings)
        settings.uploads_folder.mkdir(parents=True, exist_ok=True)
        sha256 = make_source(folder / "source", chosen.mib * MIB)
        with running_api(settings, folder / "api.log") as process:
            idle_bytes = process.peak_bytes()
            bench = Bench(folder / "source", sha256, process, make_owner(platform), platform)
            clocks = compare(bench, chosen.turns)
            peak_bytes = process.peak_bytes()
        platform.database.close()
    console = Console()
    console.print(f"Uploads in: {chosen.place}")
    console.print(table_of(clocks, chosen.mib * MIB))
    console.print(f"Load of this machine: {os.getloadavg()[0]:.1f} on {len(os.sched_getaffinity(0))} cores")
    console.print(f"API memory: {peak_bytes / MIB:.0f} MiB at most, {idle_bytes / MIB:.0f} MiB before the first upload")


if __name__ == "__main__":
    main()
