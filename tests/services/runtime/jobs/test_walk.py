"""No order of steps and faults loses a job, does one twice, or leaves a run for ever: all of them are gone through.

A state is what the rows, two workers and two sweepers hold. What is proven of a run of one or two jobs is proven for
a control and a fault at most, and for time only as far as `walk` says.
"""

from collections.abc import Callable
from dataclasses import dataclass

import pytest

from services.runtime.jobs.enqueue import enqueue, enqueue_run
from services.runtime.jobs.execution import Reporter
from services.runtime.jobs.specs import TERMINAL, Context, JobSpec
from services.runtime.orm import User
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.factory import open_store
from tests.services.runtime.jobs.outages import LostAnswers
from tests.services.runtime.jobs.walk import MOST_ATTEMPTS, Memory, MemoryDatabase, Reached, Walk, World, walk

FIRST = JobSpec("ingest.ok", {"is_first": True}, key="a")
RUNS: dict[str, tuple[tuple[JobSpec, ...], tuple[JobSpec, ...]]] = {
    "a job of its own": ((), ()),
    "one that brings another": ((FIRST,), (JobSpec("ingest.ok"),)),
    "one that waits for another": ((FIRST, JobSpec("ingest.ok", needs=("a",))), ()),
}


@dataclass
class Prepared:
    """A walk that begins with a run just queued."""

    walked: Walk

    def go(self, controls: int, faults: int) -> Reached:
        return walk(self.walked, controls, faults, self._check)

    def _check(self, world: World) -> None:
        assert_sound(world, bool(self.walked.then))
        assert_heard(self.walked, world)


@pytest.fixture
def prepared(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Prepared]:
    platform = Platform(settings, MemoryDatabase(), open_store(settings))

    def prepare(kind: str) -> Prepared:
        specs, then = RUNS[kind]
        with platform.database.transaction() as session:
            owner = User(name="ada", role="curator")
            session.add(owner)
            session.flush()
            if specs:
                enqueue_run(session, "sequence.process", specs, Context(owner.id), MOST_ATTEMPTS)
            else:
                enqueue(session, JobSpec("ingest.ok"), Context(owner.id), MOST_ATTEMPTS)
        walked = Walk(Memory(platform), LostAnswers(platform, monkeypatch), then)
        monkeypatch.setattr(Reporter, "_end_process", lambda reporter, reason: walked.ended.append(reason))
        monkeypatch.setattr("services.runtime.jobs.execution.log.warning", lambda *_, **__: None)
        return Prepared(walked)

    return prepare


def assert_sound(world: World, is_followed: bool) -> None:
    run, *others = world.rows.jobs
    jobs = others or [run]
    held = [(work.job, work.attempt) for work in world.workers if work is not None]
    assert len(set(held)) == len(held), "two processes run the same attempt"
    running = [number for number, job in enumerate(world.rows.jobs) if job.state == "running" and job.attempt]
    open_tries = [number for number, _, outcome in world.rows.attempts if not outcome]
    assert open_tries == running, "an attempt is open that does not run, or runs and is none"
    for job in jobs:
        assert job.commits == (job.state == "succeeded"), "a success is lost, or there twice"
        assert job.state != "running" or job.needs_left == 0, "it started before what it waits for"
        assert job.attempts_left >= 0
    is_over = all(job.state in TERMINAL for job in jobs)
    assert (run.state in TERMINAL) == is_over, "the run is over and its jobs are not, or the other way round"
    if run.state == "succeeded":
        assert all(job.state == "succeeded" for job in jobs), "a run succeeded without one of its jobs"
    if is_followed and others:
        assert len(others) == 1 + (others[0].state == "succeeded"), "what follows a success is lost, or there twice"


def assert_heard(walked: Walk, world: World) -> None:
    """A process that holds its job can say so: its next heartbeat passes, and its lines are written with it."""
    for work in world.workers:
        if work is None or work.phase != "working":
            continue
        job = world.rows.jobs[work.job]
        if (job.state, job.attempt) == ("running", work.attempt):
            rows, heard, _ = walked.beat(world.rows, work)
            assert rows.jobs[work.job].heartbeats == job.heartbeats + 1, "a live attempt is not heard"
            assert heard is not None, "a live attempt ended itself"
            assert not heard.has_line, "a line is never written"


def assert_ends(reached: Reached) -> None:
    """Once nothing more goes wrong every run ends, whoever is how fast."""
    assert not reached.endless()
    for world, following in reached.free.items():
        if not following:
            run = world.rows.jobs[0]
            assert run.state in TERMINAL, f"{run.state} for ever after {reached.history(world)}"


@pytest.mark.whole
@pytest.mark.parametrize(("controls", "faults"), [(1, 0), (0, 1)])
def test_every_history_of_one_job_ends_and_loses_nothing(
    prepared: Callable[[str], Prepared], controls: int, faults: int
) -> None:
    reached = prepared("a job of its own").go(controls, faults)
    assert_ends(reached)
    assert len(reached.origin) > 1000


@pytest.mark.whole
@pytest.mark.parametrize(
    ("kind", "controls", "faults"),
    [
        pytest.param("a job of its own", 1, 1, marks=pytest.mark.release),
        *(
            pytest.param(kind, 0, 1, marks=pytest.mark.release if kind != "one that waits for another" else ())
            for kind in (*RUNS,)[1:]
        ),
    ],
)
def test_every_history_of_a_small_run_ends_and_loses_nothing(
    prepared: Callable[[str], Prepared], kind: str, controls: int, faults: int
) -> None:
    """Catches alone a step of jobs that is sound by itself and not beside some other, in an order nobody thought of."""
    reached = prepared(kind).go(controls, faults)
    assert_ends(reached)
    assert (len(reached.origin), reached.steps) > (34_000, 140_000)
