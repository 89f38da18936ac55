"""The sweeper does each chore when it is due, each loop beside the others, waits outages out, and stops when told."""

import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from threading import Event, Thread
from typing import Any

import pytest
from redis import ConnectionError as RedisConnectionError
from sqlalchemy.exc import OperationalError

from services.maintenance import sweeper
from services.maintenance.sweeper import Chore, ChoreLoop, beating, loops_of, recorded, sweep, sweep_side_by_side
from services.runtime.embedded.supervisor import environment_of
from services.runtime.jobs.claims import claim
from services.runtime.platform import Platform
from services.runtime.processes.health_check import HeartbeatFile, live_processes
from services.runtime.settings import JobSettings
from testing.stone_serve import until
from tests.services.maintenance.chores import CHORES
from tests.services.runtime.jobs.steps import a_job, an_owner, job

PATIENCE_S = 300.0
PARTS = ("jobs", "submissions", "recordings", "cleaning", "scrub", "notifications", "senderone", "sendertwo", "records")
QUICK = JobSettings(lease_s=0.4, heartbeat_s=0.1, progress_s=0.1, sweep_s=0.05, rest_s=0.1)
OUTAGES = [OperationalError("BEGIN", {}, OSError("gone")), RedisConnectionError("gone"), OSError(28, "No space")]


@contextmanager
def going_round(loops: Sequence[ChoreLoop]) -> Iterator[list[BaseException]]:
    """The loops go round meanwhile, and have ended when told; what they raised."""
    stopped = Event()
    raised: list[BaseException] = []

    def go() -> None:
        try:
            sweep_side_by_side(loops, stopped.is_set)
        except KeyError as fault:
            raised.append(fault)

    thread = Thread(target=go, daemon=True)
    thread.start()
    try:
        yield raised
    finally:
        stopped.set()
        thread.join(PATIENCE_S)
    assert not thread.is_alive()


def quick(platform: Platform) -> Platform:
    """The platform, with jobs that are missed at once."""
    return replace(platform, settings=platform.settings.model_copy(update={"jobs": QUICK}))


def test_a_chore_is_done_when_it_is_due_and_not_before() -> None:
    done: list[str] = []
    chore = Chore("jobs", 10.0, lambda: done.append("jobs"))
    for now_s in (0.0, 5.0, 9.9, 10.0, 12.0):
        chore.run_if_due(now_s)
    assert len(done) == 2


def test_sweeping_ends_when_told_between_two_chores() -> None:
    done: list[str] = []
    chores = [Chore(name, 0.0, lambda name=name: done.append(name)) for name in ("first", "second")]  # type: ignore[misc]
    sweep(chores, is_stopped=lambda: len(done) >= 3)
    assert done == ["first", "second", "first"]


def test_the_platform_without_a_broker_is_swept_all_the_same(platform: Platform) -> None:
    loops = loops_of(platform)
    assert {loop.name: [chore.name for chore in loop.chores] for loop in loops} == CHORES
    assert all(chore.run_if_due(0.0) for loop in loops for chore in loop.chores)


@pytest.mark.parametrize("hung", ["expire", "settle_ended"])
def test_a_lost_job_is_taken_up_while_another_chore_hangs(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, hung: str
) -> None:
    hangs, goes_on = Event(), Event()

    def hang(*_: object) -> None:
        hangs.set()
        assert goes_on.wait(PATIENCE_S)

    monkeypatch.setattr(sweeper, hung, hang)
    job_id = a_job(platform, an_owner(platform))
    with going_round(recorded(platform, loops_of(quick(platform)))):
        try:
            until(hangs.is_set, PATIENCE_S)
            with platform.database.transaction() as session:
                assert claim(session, "ingest")
            until(lambda: job(platform, job_id).state == "queued", PATIENCE_S)
        finally:
            goes_on.set()


def test_each_loop_goes_on_through_outages_of_its_own_and_of_others() -> None:
    rounds: dict[str, int] = {"first": 0, "second": 0}

    def work(name: str) -> None:
        rounds[name] += 1
        raise OUTAGES[rounds[name] % len(OUTAGES)]

    loops = [ChoreLoop(name, (Chore(name, 0.0, lambda name=name: work(name)),)) for name in rounds]  # type: ignore[misc]
    with going_round(loops) as raised:
        until(lambda: min(rounds.values()) > 5, PATIENCE_S)
    assert raised == []


def test_a_fault_of_the_program_ends_all_loops_and_waits_for_none() -> None:
    """Whoever watches the process starts another: jobs would not be recovered any more, and nobody would know."""
    hangs, goes_on = Event(), Event()

    def hang() -> None:
        hangs.set()
        assert goes_on.wait(PATIENCE_S)

    def fail() -> None:
        assert hangs.wait(PATIENCE_S)
        raise KeyError("a bug")

    loops = [ChoreLoop("cleaning", (Chore("hang", 0.0, hang),)), ChoreLoop("jobs", (Chore("fail", 0.0, fail),))]
    try:
        with pytest.raises(KeyError):
            sweep_side_by_side(loops, lambda: False)
    finally:
        goes_on.set()


def test_a_loop_that_hangs_is_the_one_that_is_missed(platform: Platform) -> None:
    root, hangs, goes_on = platform.settings.root, Event(), Event()

    def hang() -> None:
        hangs.set()
        assert goes_on.wait(PATIENCE_S)

    rounds: list[int] = []
    loops = [ChoreLoop("cleaning", (Chore("hang", 0.0, hang),)), ChoreLoop("jobs", (Chore("jobs", 0.0, lambda: None),))]
    beats = [beating(loop, HeartbeatFile(root, part=loop.name)) for loop in loops]
    often = [replace(loop, chores=tuple(replace(chore, every_s=0.01) for chore in loop.chores)) for loop in beats]
    often[1].chores[1].work = lambda: rounds.append(1)
    with going_round(often):
        try:
            until(hangs.is_set, PATIENCE_S)
            seen = len(rounds)
            until(lambda: len(rounds) > seen + 3, PATIENCE_S)
            ages = {one.part: one.age_s for one in live_processes(root)}
        finally:
            goes_on.set()
    assert ages["cleaning"] > ages["jobs"]


@pytest.mark.whole
def test_the_process_shows_each_of_its_loops_and_ends_when_told(platform: Platform) -> None:
    root = platform.settings.root
    environment: dict[str, Any] = environment_of(platform.settings)
    command = [sys.executable, "-m", "services.maintenance.sweeper"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL) as process:
        try:
            until(lambda: len(live_processes(root)) == len(PARTS), PATIENCE_S)
            assert {(one.pid, one.part) for one in live_processes(root)} == {(process.pid, part) for part in PARTS}
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
        finally:
            process.kill()
    assert live_processes(root) == []
    assert list((root / "alive").iterdir()) == []
