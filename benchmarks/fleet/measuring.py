"""A real run gives the costs: one sequence through the embedded platform, every job's times read off its rows.

**Conventions.** The platform (Redis, API, Celery, sweeper, SQLite, folder) is started anew for every run; timed is the
processing run, by its own rows: from its first job's start to its last one's end. `taken` is how many cores whatever
was not a job of ours used meanwhile (/proc/stat, proc(5)): the platform's other processes, and strangers on a machine
that is shared. Times of jobs are seconds since the run began.
"""

import os
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from benchmarks.fleet.graph import Graph, StageJob
from client.api import Api
from client.bags import hashed_bag
from client.credentials import Server
from client.following import follow
from client.remote import add_recording, ensure_sequence, pin_calibration, start_run
from services.runtime.embedded.supervisor import running_platform
from services.runtime.exports import EXPORT
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, JobAttempt, JobNeed, LabelSet
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from simulator.pipeline import calibration_path

LISTERS = ("ingest.synchronise", "labeler.parts")
PATIENCE_S = 900.0
LOOK_S = 0.2


@dataclass(frozen=True)
class TimedJob:
    """One job; `needs` are places of jobs before it. `is_run`: of the processing run, not before or after it."""

    kind: str
    begin_s: float
    end_s: float
    cpu_s: float
    needs: tuple[int, ...]
    priority: int
    is_run: bool


@dataclass(frozen=True)
class Measured:
    """One run with so many workers on so many cores, `taken` of which others used."""

    workers: int
    cores: int
    taken: float
    frames: int
    jobs: tuple[TimedJob, ...]

    @property
    def run(self) -> tuple[TimedJob, ...]:
        return tuple(job for job in self.jobs if job.is_run)

    @property
    def wall_s(self) -> float:
        return max(job.end_s for job in self.run) - min(job.begin_s for job in self.run)

    @property
    def cpu_s(self) -> float:
        return sum(job.cpu_s for job in self.run)

    @property
    def dispatch_s(self) -> float:
        """What usually passes between the end of a job and the begin of the next, with work at hand: of one worker."""
        ordered = sorted(self.run, key=lambda job: job.begin_s)
        return median([max(0.0, after.begin_s - job.end_s) for job, after in pairwise(ordered)])

    def graph(self, *, is_whole: bool = False) -> Graph:
        """The jobs of the run, or all from registering to playback; what one lasted beyond its processor time is
        waiting. Meant of a run with one worker.
        """
        share = min(1.0, max(self.cores - self.taken, 0.01))
        chosen = [number for number, job in enumerate(self.jobs) if is_whole or job.is_run]
        place = {number: at for at, number in enumerate(chosen)}
        return Graph(tuple(_stage(self.jobs[number], share, place) for number in chosen), self.frames)


def measured(bag: Path, workers: int) -> Measured:
    """Bring the bag to a fresh platform and have it labelled. Raises `RuntimeError` when a job does not succeed."""
    with TemporaryDirectory(dir=bag.parent) as folder:
        settings = Settings(data_folder=Path(folder), workers=workers, api=ApiSettings(port=0))
        with running_platform(settings) as running, Api(Server(running.url, running.keys.token)) as api:
            sequence = ensure_sequence(api, "benchmark")
            pin_calibration(api, sequence, calibration_path(bag))
            add_recording(api, sequence, hashed_bag(bag, _silent), _silent)
            with _watched() as watch:
                root_id = start_run(api, sequence, {})["id"]
                follow(api, root_id, _silent)
            _until_idle(running.platform)
            return _read(running.platform, root_id, (workers, watch))


def record_of(run: Measured) -> dict[str, Any]:
    """As JSON keeps it."""
    jobs = [{**vars(job), "needs": list(job.needs)} for job in run.jobs]
    return {**{key: getattr(run, key) for key in ("workers", "cores", "taken", "frames")}, "jobs": jobs}


def measured_of(record: dict[str, Any]) -> Measured:
    jobs = (TimedJob(**{**job, "needs": tuple(job["needs"])}) for job in record["jobs"])
    return Measured(record["workers"], record["cores"], record["taken"], record["frames"], tuple(jobs))


@dataclass
class _Watch:
    """How long it was watched, and the processor time that the machine gave to anybody."""

    lasted_s: float = 0.0
    busy_s: float = 0.0


@contextmanager
def _watched() -> Iterator[_Watch]:
    watch, begin_s, busy_s = _Watch(), time.monotonic(), _busy_s()
    yield watch
    watch.lasted_s, watch.busy_s = time.monotonic() - begin_s, _busy_s() - busy_s


def _busy_s() -> float:
    user, nice, system, _idle, _iowait, irq, softirq, steal = map(
        int, Path("/proc/stat").read_text("ascii").split("\n", 1)[0].split()[1:9]
    )
    return (user + nice + system + irq + softirq + steal) / os.sysconf("SC_CLK_TCK")


def _until_idle(platform: Platform) -> None:
    """Until the playback is made too."""
    until_s = time.monotonic() + PATIENCE_S
    alive = select(func.count()).select_from(Job).where(Job.state.not_in(TERMINAL))
    while time.monotonic() < until_s:
        with platform.database.reading() as session:
            if not session.scalar(alive):
                return
        time.sleep(LOOK_S)
    raise RuntimeError(f"jobs were still under way after {PATIENCE_S:g} s")


def _read(platform: Platform, root_id: str, of: tuple[int, _Watch]) -> Measured:
    workers, watch = of
    with platform.database.reading() as session:
        # As they began: each after all that it needed; ids of jobs that are listed at once say nothing of that.
        rows = session.scalars(select(Job).where(Job.queue != "").order_by(Job.started_ns, Job.id)).all()
        frames = session.scalar(select(LabelSet.frames)) or 0
        needs, cpu_s = _needs(session, rows, root_id), _cpu_s(session)
    failed = [f"{row.kind}: {row.failure}" for row in rows if row.state != "succeeded"]
    if failed:
        raise RuntimeError(f"not every job succeeded: {failed}")
    origin_ns = min(row.started_ns or 0 for row in rows if row.root_id == root_id)
    jobs = tuple(
        TimedJob(
            row.kind,
            ((row.started_ns or 0) - origin_ns) / 1e9,
            ((row.finished_ns or 0) - origin_ns) / 1e9,
            cpu_s.get(row.id, 0.0),
            needs[place],
            row.priority,
            row.root_id == root_id,
        )
        for place, row in enumerate(rows)
    )
    ours_s = sum(job.cpu_s for job in jobs if job.is_run)
    cores = len(os.sched_getaffinity(0))
    return Measured(workers, cores, max(0.0, watch.busy_s - ours_s) / watch.lasted_s, frames, jobs)


def _cpu_s(session: Session) -> dict[str, float]:
    spent = select(JobAttempt.job_id, func.sum(JobAttempt.cpu_s)).group_by(JobAttempt.job_id)
    return {job_id: float(cpu_s or 0.0) for job_id, cpu_s in session.execute(spent)}


def _needs(session: Session, rows: Any, root_id: str) -> list[tuple[int, ...]]:
    """As places: what the rows say, else the job that named it, else what has to be there before a run."""
    place = {row.id: number for number, row in enumerate(rows)}
    named: dict[str, list[int]] = {}
    for job_id, needed_id in session.execute(select(JobNeed.job_id, JobNeed.needed_id)):
        named.setdefault(job_id, []).append(place[needed_id])
    found: list[tuple[int, ...]] = []
    lister = last = -1
    for number, row in enumerate(rows):
        before = last if row.kind == EXPORT else lister
        found.append(tuple(named.get(row.id, ())) or ((before,) if before >= 0 else ()))
        if row.kind in LISTERS or row.root_id != root_id:
            lister = number
        last = number if row.root_id == root_id else last
    return found


def _stage(job: TimedJob, share: float, place: Mapping[int, int]) -> StageJob:
    waited_s = max(0.0, job.end_s - job.begin_s - job.cpu_s / share)
    needs = tuple(place[need] for need in job.needs if need in place)
    return StageJob(job.kind, job.cpu_s, waited_s, needs, job.priority)


def _silent(_stage: str, _done: int, _total: int) -> None:
    return
