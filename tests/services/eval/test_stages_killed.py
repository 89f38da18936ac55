"""Real workers: killed with −9 in the middle of a part, and side by side; whatever they do is done once.

Catches alone a scoring that is lost or doubled when the process that does it is killed.
"""

import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from services.domain.benchmarks.submissions import scoring_ranges
from services.eval import examination
from services.eval.queue_handlers import handlers
from services.runtime.database.transactions import Database
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.lease_sweep import Sweeper
from services.runtime.orm import JobAttempt
from services.runtime.platform import Platform
from services.runtime.store.factory import open_store
from testing.process_states import children_of, is_running
from testing.stone_serve import PATIENCE_S, until
from testing.worlds.benchmark_world import World, benchmark_world, run_eval
from testing.worlds.sending import guess, jobs_of, parts_left, row_of, scores_of, send, taken, zipped

pytestmark = pytest.mark.whole


@pytest.fixture(scope="module")
def world(standing: World) -> World:
    return standing


def started(platform: Platform, jobs: int) -> int:
    """The pid of a worker process that runs so many jobs at most, with connections of its own."""
    pid = os.fork()
    if pid == 0:
        try:
            own = Platform(platform.settings, Database(platform.settings), open_store(platform.settings))
            while jobs and run_next(own, "eval", handlers(own)):
                jobs -= 1
        finally:
            os._exit(0)
    return pid


@contextmanager
def working(platform: Platform) -> Iterator[int]:
    """The pid of a worker process that runs one job; it is gone afterwards."""
    pid = started(platform, 1)
    try:
        yield pid
    finally:
        os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def give_back_silent(platform: Platform) -> None:
    """What the sweeper does when a lease has gone by without a heartbeat."""
    clock = iter((0.0, platform.settings.jobs.lease_s + 1.0))
    sweeper = Sweeper(platform, lambda queue: 0, lambda queue, times: None, lambda: next(clock))
    assert sweeper.recover() == 0
    assert sweeper.recover() == 1


@pytest.mark.parametrize("kind", ["eval.open", "eval.part"])
def test_a_worker_killed_in_the_middle_is_replaced_and_scores_once(
    world: World, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1 if kind == "eval.part" else 500)
    submission_id = send(world, zipped(world, guess(world, turn=len(kind))))
    if kind == "eval.part":
        run_next(world.platform, "eval", handlers(world.platform))
    with monkeypatch.context() as slowly:
        slowly.setattr(examination, "count_range", lambda *given, **named: time.sleep(PATIENCE_S))
        with working(world.platform) as worker:
            until(lambda: bool(children_of(worker)))
            (reader,) = children_of(worker)
            os.kill(worker, signal.SIGKILL)
            until(lambda: not is_running(reader))
    assert [job.state for job in jobs_of(world.platform, submission_id)].count("running") == 1
    assert (scores_of(world.platform, submission_id), parts_left(world.platform)) == ([], 0)
    give_back_silent(world.platform)
    run_eval(world.platform)
    assert row_of(world.platform, submission_id).state == "scored"
    assert sorted(job.attempt for job in jobs_of(world.platform, submission_id))[-1] == 2
    assert outcomes_of(world, submission_id, kind) == ["lost", "succeeded"]
    assert len(scores_of(world.platform, submission_id)) == 1
    assert (taken(world.platform, submission_id), parts_left(world.platform)) == (1, 0)


def outcomes_of(world: World, submission_id: str, kind: str) -> list[str]:
    """Of the attempts at the first job of the kind."""
    job = next(job for job in jobs_of(world.platform, submission_id) if job.kind == kind)
    with world.platform.database.reading() as session:
        return [session.get_one(JobAttempt, (job.id, number)).outcome for number in range(1, job.attempt + 1)]


def test_workers_side_by_side_score_each_submission_once(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some send in the same, and one team's are settled at the same time as another's."""
    world = benchmark_world(platform_on, frames=1)
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    contents = [zipped(world, guess(world, turn=turn)) for turn in range(2)]
    sent = [send(world, contents[number % 2], team=number // 2) for number in range(4)]
    platform_on.database.close()  # before the fork: no connection is shared
    workers = [started(platform_on, 100) for _ in range(2)]
    for worker in workers:
        os.waitpid(worker, 0)
    run_eval(platform_on)
    for submission_id in sent:
        assert row_of(platform_on, submission_id).state == "scored"
        assert len(scores_of(platform_on, submission_id)) == 1
        assert taken(platform_on, submission_id) == 1
        assert {job.state for job in jobs_of(platform_on, submission_id)} == {"succeeded"}
    assert len({scores_of(platform_on, one)[0].content_sha256 for one in sent}) == 2
    assert parts_left(platform_on) == 0
