"""The cost of sandboxed children for a labelling run: `python -m benchmarks.sandbox`.

A simulated drive is registered on a platform in a folder; then one process runs its jobs (synchronise, label, publish)
from one queue to the other. In turns, every job runs in a sandboxed child, forked from a fork server like a worker's,
or in the process itself. Each turn has a process and a copy of the folder of its own, and has loaded its kernels
before. Processor time covers the process, the fork server and all children, user and system; on a busy machine use this
figure.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table
from sqlalchemy import func, select

from services.ingest import kernel_warmup as ingest_kernels
from services.labeler import kernel_warmup as labeler_kernels
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.orm import Job, SequenceRow
from services.runtime.platform import Platform
from services.runtime.processes.worker import FORKED_FROM
from services.runtime.sandbox import LIMITS, UNWATCHED, SandboxLimits, SandboxWatch, job_sandbox, sandboxed
from services.runtime.sandbox.child import ProgressCallback
from services.runtime.sandbox.fork_client import ForkServer, use_fork_server
from services.runtime.sandbox.job_sandbox import CHILDREN
from services.runtime.settings import Settings, ViewingSettings
from services.runtime.store.factory import open_store
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from testing.worlds.runs import NAME, Brought, bring_ready, run_all

Used = Callable[[], tuple[float, float]]

APART, ITSELF = "in children", "in the process"
TICKS_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class TurnCost:
    """The cost of one run; `system_s` of the processor time was spent in the kernel."""

    cpu_s: float
    system_s: float
    wall_s: float
    jobs: int


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--channels", type=int, default=32)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    parser.add_argument("--turn", choices=(APART, ITSELF), help="one turn only, on the platform in the folder")
    options = parser.parse_args()
    if options.turn:
        print(json.dumps(vars(turn(options.folder, options.turn))))
        return
    options.folder.mkdir(parents=True, exist_ok=True)
    bag = options.folder / f"sandbox-{options.channels}-{options.seconds:g}.mcap"
    if not bag.exists():
        simulate(bag, SimulateOptions(options.seconds, channels=options.channels))
    with tempfile.TemporaryDirectory(dir=options.folder) as folder:
        prepared = Path(folder) / "prepared"
        _prepare(prepared, bag)
        turns = [{how: _turn_of_its_own(prepared, how) for how in (APART, ITSELF)} for _ in range(options.turns)]
    _show(turns, options.seconds)


def turn(folder: Path, how: str) -> TurnCost:
    """Run once on the platform in the folder, in this process."""
    platform = _opened(folder)
    used = _ways()[how]()
    with platform.database.transaction() as session:
        sequence = session.scalars(select(SequenceRow).where(SequenceRow.name == NAME)).one()
    brought = Brought(platform, sequence.owner_id, sequence.id)
    run_id = brought.process()
    before, begun_s = used(), time.monotonic()
    run_all(platform)
    after, wall_s = used(), time.monotonic() - begun_s
    user_s, system_s = (now - earlier for now, earlier in zip(after, before, strict=True))
    cost = TurnCost(user_s + system_s, system_s, wall_s, _jobs_done(platform, run_id))
    platform.database.close()
    return cost


def _ways() -> Mapping[str, Callable[[], Used]]:
    """Return the setup of each way; it returns a function of the used user and system time."""
    return {APART: _use_children, ITSELF: _use_no_child}


def _use_children() -> Used:
    server = use_fork_server([*FORKED_FROM["ingest"], *FORKED_FROM["labeler"]])
    sandboxed(bytes)  # a first call ensures that it is loaded

    def used() -> tuple[float, float]:
        ours, theirs = _own_s(), _server_s(server)
        return ours[0] + theirs[0], ours[1] + theirs[1]

    return used


def _use_no_child() -> Used:
    def here(
        work: Callable[[ProgressCallback], bytes], limits: SandboxLimits = LIMITS, watch: SandboxWatch = UNWATCHED
    ) -> bytes:
        try:
            return work(watch.progress)
        finally:
            tempfile.tempdir = None  # the folder is deleted with the job

    job_sandbox.sandboxed_with_progress = here  # type: ignore[attr-defined]  # what it was imported as
    job_sandbox.sandboxed_in_run = lambda wanted: here(wanted.work, wanted.limits, wanted.watch)
    ingest_kernels.warm()
    labeler_kernels.warm()
    return _own_s


def _own_s() -> tuple[float, float]:
    """Return the time of this process. Its children are the fork server's."""
    used = os.times()
    return used.user, used.system


def _server_s(server: ForkServer) -> tuple[float, float]:
    """Return the time of the fork server and its children (proc(5)); the spare child is ended to be counted."""
    CHILDREN.close()
    fields = Path(f"/proc/{server.pid}/stat").read_text().rpartition(")")[2].split()
    user, system, user_below, system_below = (int(ticks) / TICKS_S for ticks in fields[11:15])
    return user + user_below, system + system_below


def _prepare(folder: Path, bag: Path) -> None:
    """Create a platform with the recording registered."""
    platform = _opened(folder)
    upgrade(platform.settings)
    bring_ready(platform, bag)
    platform.database.close()


def _opened(folder: Path) -> Platform:
    settings = Settings(data_folder=folder, viewing=ViewingSettings(makes_playback=False))
    return Platform(settings, Database(settings), open_store(settings))


def _jobs_done(platform: Platform, run_id: str) -> int:
    """Return the number of jobs. Raises `RuntimeError` for a run that did not succeed."""
    with platform.database.reading() as session:
        state = session.get_one(Job, run_id).state
        jobs = session.scalar(select(func.count()).where(Job.root_id == run_id, Job.queue != ""))
    if state != "succeeded":
        raise RuntimeError(f"the run is {state}")
    return jobs or 0


def _turn_of_its_own(prepared: Path, how: str) -> dict[str, Any]:
    """Run a turn in a process of its own, on a copy of the platform."""
    with tempfile.TemporaryDirectory(dir=prepared.parent) as folder:
        copy = Path(folder) / "data"
        shutil.copytree(prepared, copy, symlinks=True)
        command = [sys.executable, "-m", "benchmarks.sandbox", "--turn", how, "--folder", str(copy)]
        ended = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        cost: dict[str, Any] = json.loads(ended.stdout.splitlines()[-1])
        print(how, cost, file=sys.stderr)
        return cost


def _show(turns: list[dict[str, dict[str, Any]]], recorded_s: float) -> None:
    jobs = turns[0][APART]["jobs"]
    table = Table(title=f"{recorded_s:g} s recorded, {jobs} jobs, {len(turns)} turns: median (range)")
    for column in ("", APART, ITSELF, "ratio of a pair"):
        table.add_column(column, justify="right")
    for figure, named in (("cpu_s", "processor s"), ("system_s", "share in the kernel"), ("wall_s", "wall s")):
        columns = [[pair[how][figure] for pair in turns] for how in (APART, ITSELF)]
        ratios = [apart / itself for apart, itself in zip(*columns, strict=True)]
        table.add_row(named, *(_told(column, ".1f") for column in columns), _told(ratios, ".3f"))
    Console().print(table)


def _told(figures: list[float], form: str) -> str:
    return f"{median(figures):{form}} ({min(figures):{form}}–{max(figures):{form}})"


if __name__ == "__main__":
    main()
