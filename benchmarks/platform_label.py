"""One sequence through the real platform with 1 and with 2 workers: `python -m benchmarks.platform_label`.

The embedded platform (Redis, API, Celery, sweeper) is started anew for every number of workers; a simulated bag is
uploaded through the API, registered, and processed. Only the run is timed, by its own rows, from its first job's start
to its end. Two figures are independent of other load: the processor time of every job, and the shortest possible time
for that many workers with jobs of this cost and their dependencies.
"""

import argparse
import tempfile
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table
from sqlalchemy import func, select

from services.runtime.embedded.supervisor import running_platform
from services.runtime.orm import Job, JobAttempt, JobNeed
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings, Settings
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.files.bags import hashed_bag
from stone_client.server.job_following import follow
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

LISTERS = ("ingest.synchronise", "labeler.parts")


@dataclass(frozen=True)
class JobMeasurement:
    """One job of a run; `needs` are indices of earlier jobs."""

    kind: str
    cpu_s: float
    wall_s: float
    needs: tuple[int, ...]


@dataclass(frozen=True)
class PlatformRunMeasurement:
    """One run with a number of workers."""

    workers: int
    wall_s: float
    jobs: tuple[JobMeasurement, ...]

    @property
    def cpu_s(self) -> float:
        return sum(job.cpu_s for job in self.jobs)

    def idle_s(self) -> float:
        """Return the worker-seconds without a job."""
        return self.workers * self.wall_s - sum(job.wall_s for job in self.jobs)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--channels", type=int, default=64)
    parser.add_argument("--columns", type=int, default=900)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    options = parser.parse_args()
    bag = options.folder / f"platform-{options.channels}x{options.columns}-{options.seconds:g}.mcap"
    if not bag.exists():
        simulate(bag, SimulateOptions(options.seconds, channels=options.channels, columns=options.columns))
    runs = [measured(bag, workers) for workers in options.workers]
    _show(runs, options.seconds)


def measured(bag: Path, workers: int) -> PlatformRunMeasurement:
    """Upload the bag to a fresh platform and label it."""
    with tempfile.TemporaryDirectory(dir=bag.parent) as folder:
        settings = Settings(data_folder=Path(folder), workers=workers, api=ApiSettings(port=0))
        with running_platform(settings) as running, Api(Server(running.url, running.keys.token)) as api:
            sequence = ensure_sequence(api, "benchmark")
            pin_calibration(api, sequence, calibration_path(bag))
            add_recording(api, sequence, hashed_bag(bag, _silent), _silent)
            job_id = start_run(api, sequence, {})["id"]
            follow(api, job_id, _silent)
            return _read(running.platform, job_id, workers)


def shortest_s(jobs: tuple[JobMeasurement, ...], workers: int) -> float:
    """Return the end of the last job if every free worker takes the first ready job, each for its processor time."""
    ends: dict[int, float] = {}
    free = [0.0] * workers
    left = list(range(len(jobs)))
    while left:
        known = [index for index in left if all(need in ends for need in jobs[index].needs)]
        ready_s = {index: max((ends[need] for need in jobs[index].needs), default=0.0) for index in known}
        worker = min(range(workers), key=free.__getitem__)
        at_s = max(free[worker], min(ready_s.values()))
        index = next(index for index in known if ready_s[index] <= at_s)
        ends[index] = free[worker] = at_s + jobs[index].cpu_s
        left.remove(index)
    return max(ends.values())


def longest_chain(jobs: tuple[JobMeasurement, ...]) -> tuple[JobMeasurement, ...]:
    """Return the chain of dependent jobs with the most processor time, in order: the lower limit for any number of
    workers.
    """
    chains: list[tuple[JobMeasurement, ...]] = []
    for job in jobs:
        chains.append((*max((chains[need] for need in job.needs), key=_chain_s, default=()), job))
    return max(chains, key=_chain_s)


def _chain_s(chain: tuple[JobMeasurement, ...]) -> float:
    return sum(job.cpu_s for job in chain)


def _read(platform: Platform, root_id: str, workers: int) -> PlatformRunMeasurement:
    with platform.database.reading() as session:
        rows = session.scalars(select(Job).where(Job.root_id == root_id, Job.queue != "").order_by(Job.id)).all()
        needs = session.execute(select(JobNeed.job_id, JobNeed.needed_id)).all()
        cpu_s = dict(
            session.execute(select(JobAttempt.job_id, func.sum(JobAttempt.cpu_s)).group_by(JobAttempt.job_id)).all()
        )
    number_of = {row.id: number for number, row in enumerate(rows)}
    needed = defaultdict(list)
    for job_id, needed_id in needs:
        needed[job_id].append(number_of[needed_id])
    jobs, lister = [], -1
    for number, row in enumerate(rows):
        follows = tuple(needed[row.id]) or ((lister,) if lister >= 0 else ())
        jobs.append(JobMeasurement(row.kind, float(cpu_s[row.id] or 0), _wall_s(row), follows))
        if row.kind in LISTERS:
            lister = number  # later jobs were created by this one
    begin, end = min(row.started_ns or 0 for row in rows), max(row.finished_ns or 0 for row in rows)
    return PlatformRunMeasurement(workers, (end - begin) / 1e9, tuple(jobs))


def _wall_s(row: Job) -> float:
    return ((row.finished_ns or 0) - (row.started_ns or 0)) / 1e9


def _show(runs: list[PlatformRunMeasurement], recorded_s: float) -> None:
    console = Console()
    table = Table(title=f"{recorded_s:g} s recorded, through the platform")
    for column in ("workers", "wall s", "× real time", "CPU s", "idle worker-s", "shortest s", "jobs"):
        table.add_column(column, justify="right")
    for run in runs:
        shortest = shortest_s(run.jobs, run.workers)
        figures = (run.wall_s, recorded_s / run.wall_s, run.cpu_s, run.idle_s(), shortest)
        table.add_row(str(run.workers), *(f"{figure:.2f}" for figure in figures), str(len(run.jobs)))
    console.print(table)
    _show_stages(console, runs)
    for run in runs:
        chain = longest_chain(run.jobs)
        kinds = " → ".join(f"{job.kind.partition('.')[2]} {job.cpu_s:.2f}" for job in chain)
        console.print(f"longest chain with {run.workers}: {_chain_s(chain):.2f} s of processor time: {kinds}")
    first, last = runs[0], runs[-1]
    if last.workers > first.workers:
        ideal = shortest_s(first.jobs, first.workers) / shortest_s(first.jobs, last.workers)
        console.print(f"{first.workers} → {last.workers} workers: {first.wall_s / last.wall_s:.2f}× by the clock")
        console.print(f"{ideal:.2f}× at most, by the processor times of the run with {first.workers}")


def _show_stages(console: Console, runs: list[PlatformRunMeasurement]) -> None:
    table = Table(title="per stage: jobs, CPU s, longest job's CPU s")
    table.add_column("stage")
    for run in runs:
        table.add_column(f"{run.workers} workers", justify="right")
    for kind in dict.fromkeys(job.kind for job in runs[0].jobs):
        cells = []
        for run in runs:
            costs = [job.cpu_s for job in run.jobs if job.kind == kind]
            cells.append(f"{len(costs)}  {sum(costs):.2f}  {max(costs):.2f}")
        table.add_row(kind, *cells)
    console.print(table)


def _silent(_stage: str, _done: int, _total: int) -> None:
    return


if __name__ == "__main__":
    main()
