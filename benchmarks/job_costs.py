"""What each kind of job asks of database and store: `python -m benchmarks.job_costs [--seconds 60] [--keep]`.

One sequence goes through the real stages on PostgreSQL and S3 in this process, a job at a time; every transaction, and
every byte that the store's client sends or gets, is counted for the job under way. `--machines` jobs in turn have
folders of their own, as on so many machines: the more, the more of what one job leaves must be fetched by the next; 0
is a fresh machine for every job, the worst case.
"""

import argparse
import json
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table
from sqlalchemy import event, func, select

from services.ingest import stages as ingest
from services.ingest.stages import open_recording
from services.labeler import stages as labeler
from services.runtime.database import Database
from services.runtime.jobs.running import run_next
from services.runtime.jobs.specs import TERMINAL
from services.runtime.migrate import upgrade
from services.runtime.orm import Artefact, ExportPack, Job, LabelSet
from services.runtime.platform import Platform
from services.runtime.sample_sources import provide_samples
from services.runtime.settings import DatabaseSettings, Settings
from services.runtime.store_s3 import S3Store
from services.runtime.sweep_sources import provide_sweeps
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from tests.servers.postgres import running_postgres
from tests.servers.s3 import running_s3
from tests.services.runs import Brought, bring

KEPT = Path(__file__).parent / "fleet" / "costs.json"
QUEUES = (("ingest", ingest.handlers), ("labeler", labeler.handlers))
ROUNDS = 10_000


@dataclass
class Asked:
    """What one job, or many of a kind, asked for."""

    jobs: int = 0
    transactions: int = 0
    requests: int = 0
    put_bytes: int = 0
    get_bytes: int = 0


@dataclass
class Count:
    """Counts for the job under way, by kind once it has ended."""

    now: Asked = field(default_factory=Asked)
    by_kind: dict[str, Asked] = field(default_factory=dict)

    def end(self, kind: str) -> None:
        of_kind = self.by_kind.setdefault(kind, Asked())
        of_kind.jobs += 1
        for name in ("transactions", "requests", "put_bytes", "get_bytes"):
            setattr(of_kind, name, getattr(of_kind, name) + getattr(self.now, name))
        self.now = Asked()

    def watch(self, platform: Platform) -> None:
        """Count what this platform's engine and S3 client do."""
        for end in ("commit", "rollback"):  # what only read is a transaction too
            event.listen(platform.database.engine, end, self._ended)
        assert isinstance(platform.store, S3Store)  # noqa: S101  # a benchmark of S3
        events = platform.store._client.meta.events  # counted where every request passes
        events.register("before-send.s3", self._send)
        events.register("after-call.s3.GetObject", self._got)

    def _ended(self, _connection: Any) -> None:
        self.now.transactions += 1

    def _send(self, request: Any, **_: Any) -> None:
        self.now.requests += 1
        if request.method == "PUT":
            self.now.put_bytes += int(request.headers.get("Content-Length") or 0)

    def _got(self, parsed: dict[str, Any], **_: Any) -> None:
        self.now.get_bytes += int(parsed.get("ContentLength") or 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--machines", type=int, default=0)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    parser.add_argument("--json", type=Path, default=Path("build") / "job-costs.json")
    parser.add_argument("--keep", action="store_true", help=f"also as {KEPT.name}, for benchmarks.fleet")
    options = parser.parse_args()
    bag = options.folder / f"scale-64x900-{options.seconds:g}.mcap"
    if not bag.exists():
        simulate(bag, SimulateOptions(options.seconds, channels=64, columns=900))
    record = counted(bag, options.machines)
    for path in (options.json, *((KEPT,) if options.keep else ())):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=1) + "\n", "utf-8")
    _show(record)


def counted(bag: Path, machines: int) -> dict[str, Any]:
    """By kind what a job asks on average, and what is kept of the sequence in the end."""
    with tempfile.TemporaryDirectory(dir=bag.parent) as folder, _first_machine(Path(folder) / "0") as first:
        count = Count()
        provide_sweeps(ingest.open_described)  # as services.ingest.tasks does in a worker
        provide_samples(open_recording)
        brought = bring(first)
        brought.calibrate(calibration_path(bag))
        brought.add(bag)
        _run_all(first, (Path(folder), machines), count)
        brought.process()
        _run_all(first, (Path(folder), machines), count)
        kinds = {kind: _average(asked) for kind, asked in sorted(count.by_kind.items())}
        return {"machines": machines, "kinds": kinds, **_kept(brought)}


@contextmanager
def _first_machine(folder: Path) -> Iterator[Platform]:
    with running_postgres() as postgres, running_s3() as s3:
        settings = Settings(data_folder=folder, database=DatabaseSettings(postgres.url()), store=s3.settings())
        upgrade(settings)
        database = Database(settings)
        yield Platform(settings, database, S3Store(settings))
        database.close()


def _run_all(first: Platform, at: tuple[Path, int], count: Count) -> None:
    """Job after job, each on the next machine, until none is ready."""
    folder, machines = at
    for number in range(ROUNDS):
        place = number % machines if machines else number
        platform = _machine(first, folder / f"machine-{place}")
        count.watch(platform)
        before = _ended(platform)
        count.now = Asked()
        is_done = any(run_next(platform, queue, handlers(platform)) for queue, handlers in QUEUES)
        now = replace(count.now)
        if not is_done:
            return
        count.now = now
        (kind,) = (_ended(platform) - before).elements()
        count.end(kind)
        platform.database.close()


def _machine(first: Platform, folder: Path) -> Platform:
    """Another machine of the same platform; what was uploaded lies in a folder that all share."""
    folder.mkdir(parents=True, exist_ok=True)
    shared = folder / "uploads"
    if not shared.exists():
        shared.symlink_to(first.settings.uploads_folder, target_is_directory=True)
    settings = first.settings.model_copy(update={"data_folder": folder})
    return Platform(settings, Database(settings), S3Store(settings))


def _ended(platform: Platform) -> Counter[str]:
    with platform.database.reading() as session:
        ended = select(Job.kind, func.count()).where(Job.state.in_(TERMINAL), Job.queue != "").group_by(Job.kind)
        return Counter(dict(session.execute(ended).all()))


def _average(asked: Asked) -> dict[str, float]:
    names = ("transactions", "requests", "put_bytes", "get_bytes")
    return {"jobs": asked.jobs, **{name: round(getattr(asked, name) / asked.jobs, 1) for name in names}}


def _kept(brought: Brought) -> dict[str, float]:
    """Bytes that stay in the store, of the recording aside. Raises `RuntimeError` where a job did not succeed."""
    with brought.platform.database.reading() as session:
        failed = session.execute(select(Job.kind, Job.failure).where(Job.state != "succeeded")).all()
        if failed:
            raise RuntimeError(f"not every job succeeded: {failed}")
        labels = session.scalar(select(func.sum(Artefact.size_bytes))) or 0
        playback = session.scalar(select(func.sum(ExportPack.size_bytes))) or 0
        frames = session.scalar(select(LabelSet.frames)) or 0
    return {
        "frames": frames,
        "recording_bytes": brought.recording().size_bytes,
        "labels_bytes": int(labels),
        "playback_bytes": int(playback),
    }


def _show(record: dict[str, Any]) -> None:
    table = Table(title="what a job asks, on average")
    for column in ("kind", "jobs", "transactions", "store requests", "MB put", "MB got"):
        table.add_column(column, justify="left" if column == "kind" else "right")
    for kind, one in record["kinds"].items():
        megabytes = (f"{one[name] / 1e6:.1f}" for name in ("put_bytes", "get_bytes"))
        table.add_row(kind, str(one["jobs"]), f"{one['transactions']:.1f}", f"{one['requests']:.1f}", *megabytes)
    console = Console(width=120)
    console.print(table)
    for name in ("recording_bytes", "labels_bytes", "playback_bytes"):
        console.print(f"{name} {record[name] / 1e6:.1f} MB for {record['frames']} frames")


if __name__ == "__main__":
    main()
