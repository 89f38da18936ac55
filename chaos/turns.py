"""One round of the kill suite: an owner uploads, processes and waits while processes are killed.

**Conventions.** The owner uses the client's own functions over HTTP, as users do. `chance`, seeded with the seed, the
kind and the round, draws the moments.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from random import Random
from typing import Any

from sqlalchemy import func, select

from chaos.inputs import SEQUENCE
from chaos.places import PlatformUnderTest, RoundOwner
from chaos.result_hashes import OwnerRun
from chaos.verdict import Violation
from services.runtime.orm import Job, JobAttempt
from stone_client.api import Api
from stone_client.files.bags import hashed_bag
from stone_client.server.sequences import add_recording, ensure_sequence, pin_calibration, start_run

PATIENCE_S = 120.0
LOOK_S = 0.02
TERMINAL = ("succeeded", "failed", "cancelled")
Item = Mapping[str, Any]


class StuckError(Exception):
    """An awaited condition did not come true."""

    def __init__(self, what: str, within_s: float) -> None:
        super().__init__(f"{what} did not happen within {within_s:g} s")


@dataclass(frozen=True)
class RoundKill:
    """A kill: its time (monotonic), whether it hit running work, and its victim."""

    at_s: float
    is_hit: bool
    what: str


@dataclass(frozen=True)
class UndisturbedRun:
    """An undisturbed run: its duration, and its number of jobs."""

    run_s: float = 1.0
    jobs: int = 1


@dataclass(frozen=True)
class OwnerRound:
    """An owner's round on a platform."""

    target: PlatformUnderTest
    owner: RoundOwner
    chance: Random
    undisturbed: UndisturbedRun
    struck: list[RoundKill] = field(default_factory=list)
    violations: list[Violation] = field(default_factory=list)

    def connected(self, url: str = "") -> Api:
        """Return the owner's connection, directly or by a detour."""
        server = self.owner.server
        return Api(replace(server, url=url or server.url), patience_s=PATIENCE_S)

    def announce(self, api: Api) -> Item:
        """Create a sequence with its calibration."""
        sequence = ensure_sequence(api, SEQUENCE)
        pin_calibration(api, sequence, self.target.inputs.calibration)
        return sequence

    def send(self, api: Api, sequence: Item) -> None:
        """Upload the recording and wait until it is registered."""
        add_recording(api, sequence, hashed_bag(self.target.inputs.bag, _silent), _silent)

    def process(self, api: Api, sequence: Item) -> OwnerRun:
        """Start the run; the upload is complete by then."""
        run = start_run(api, sequence, {})
        inputs = self.target.inputs
        return OwnerRun(self.owner.user_id, sequence["id"], run["id"], inputs.sha256, inputs.size_bytes)

    def wait_for_moment(self, run_id: str, latest_ratio: float = 0.95) -> None:
        """Wait for a random moment within the run: some number of ended jobs, then a short pause.

        Counting jobs instead of seconds makes the moment independent of the machine's speed.
        """
        after_jobs = int(self.chance.uniform(0.0, latest_ratio) * self.undisturbed.jobs)
        pause_s = self.chance.random() * self.undisturbed.run_s / self.undisturbed.jobs
        await_true(f"{after_jobs} jobs of run {run_id}", lambda: self._ended_jobs(run_id) >= after_jobs)
        time.sleep(pause_s)

    def note(self, what: str, *, is_hit: bool) -> None:
        """Note the victim right before the kill."""
        self.struck.append(RoundKill(time.monotonic(), is_hit, what))

    def _ended_jobs(self, run_id: str) -> int:
        """Return the number of ended jobs of the run; all of its jobs, once it has failed."""
        run_ended = select(Job.id).where(Job.id == run_id, Job.state.in_(TERMINAL))
        ended = select(func.count()).where(Job.root_id == run_id, Job.id != run_id, Job.state.in_(TERMINAL))
        with self.target.platform.database.reading() as session:
            return self.undisturbed.jobs if session.scalar(run_ended) else session.scalar(ended) or 0

    def busy_processes(self) -> list[int]:
        """Return the pids that run a job of this owner."""
        mine = (Job.owner_id == self.owner.user_id, Job.state == "running", JobAttempt.number == Job.attempt)
        statement = select(JobAttempt.worker).join(Job, Job.id == JobAttempt.job_id).where(*mine)
        with self.target.platform.database.reading() as session:
            return [int(worker.rpartition(":")[2]) for worker in session.scalars(statement)]


def await_end(api: Api, run_id: str) -> Item:
    """Return the run once it has ended in any state. Raises `StuckError`."""
    runs: list[Item] = []

    def has_ended() -> bool:
        runs[:] = [api.read(f"/jobs/{run_id}")]
        return runs[0]["state"] in TERMINAL

    await_true(f"the end of run {run_id}", has_ended, every_s=0.1)
    return runs[0]


def await_true(what: str, is_true: Callable[[], bool], every_s: float = LOOK_S, within_s: float = PATIENCE_S) -> None:
    """Wait until the condition is true. Raises `StuckError`."""
    until_s = time.monotonic() + within_s
    while not is_true():
        if time.monotonic() > until_s:
            raise StuckError(what, within_s)
        time.sleep(every_s)


def _silent(stage: str, done: int, total: int) -> None:
    """Ignore progress."""
