"""The lease keeper: the attempts of a worker are renewed together, and each by itself where no keeper answers."""

import os
import signal
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from secrets import token_hex
from threading import Barrier, Event, Thread

import pytest
from sqlalchemy import select

from services.runtime.jobs import lease_keeper
from services.runtime.jobs.attempt_lines import AttemptLine, AttemptWords, progress_now
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import cancel
from services.runtime.jobs.lease_keeper import (
    LeaseKeeper,
    LeaseLine,
    PresenceLine,
    ProcessPresence,
    message_of,
    opened,
    start_keeper,
)
from services.runtime.jobs.leases import LeaseAnswer
from services.runtime.jobs.worker_presence import WorkerHeartbeat
from services.runtime.orm import CounterRow, Worker
from services.runtime.platform import Platform
from services.runtime.telemetry.counter_rows import counters_of_all_processes
from services.runtime.telemetry.counters import LEASES_EXPIRED, process_counters
from testing.process_states import is_running
from testing.refusals import refused_as
from tests.services.runtime.jobs.outages import GONE, Away
from tests.services.runtime.jobs.steps import a_job, an_owner, job

PATIENCE_S = 60.0
TURN_S = 0.2


def until(is_so: Callable[[], bool]) -> None:
    end_s = time.monotonic() + PATIENCE_S
    while not is_so():
        assert time.monotonic() < end_s
        time.sleep(0.01)


@pytest.fixture
def address(platform_on: Platform, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """Where a keeper listens, in a thread of this process."""
    address, over = f"\0stone-test-{token_hex(8)}", Event()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as listener:
        listener.bind(address)
        listener.listen()
        keeper = LeaseKeeper(platform_on.database, listener, TURN_S, TURN_S)
        keeper.begin()

        def serve() -> None:
            while not over.is_set():
                keeper.step(0.05)

        thread = Thread(target=serve)
        thread.start()
        monkeypatch.setattr(lease_keeper, "_ADDRESS", [address])
        yield address
        over.set()
        thread.join()
        keeper.close()


def claimed(platform: Platform, count: int) -> list[AttemptWords]:
    owner = an_owner(platform)
    for _ in range(count):
        a_job(platform, owner)
    words = []
    with platform.database.transaction() as session:
        for _ in range(count):
            taken = claim(session, "ingest")
            assert taken is not None
            words.append(AttemptWords(taken.job_id, taken.attempt))
    return words


@pytest.mark.usefixtures("address")
def test_what_several_attempts_say_is_written_together(platform_on: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    turns: list[int] = []
    usual = lease_keeper.renew

    def counted(database: object, words: list[AttemptWords], *beside: object) -> list[LeaseAnswer]:
        turns.append(len(words))
        return usual(database, words, *beside)  # type: ignore[arg-type]

    monkeypatch.setattr(lease_keeper, "renew", counted)
    attempts, together = claimed(platform_on, 4), Barrier(4)

    def speak(words: AttemptWords) -> None:
        line = LeaseLine(platform_on.database, PATIENCE_S)
        for _ in range(3):
            together.wait()
            assert line.renew(words) == LeaseAnswer(True)
        line.close()

    threads = [Thread(target=speak, args=(words,)) for words in attempts]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [job(platform_on, words.job_id).heartbeats for words in attempts] == [3] * 4
    assert sum(turns) == 12
    assert len(turns) <= 6, "the first of each round may come alone"


@pytest.mark.usefixtures("address")
def test_an_attempt_is_answered_as_by_the_database_itself(platform_on: Platform) -> None:
    words, other = claimed(platform_on, 2)
    line = LeaseLine(platform_on.database, PATIENCE_S)
    said = AttemptWords(
        words.job_id, 1, progress_now("frames", 3, 8), (AttemptLine(0, "info", "opened", {"nan": 1.5}, 1),)
    )
    assert line.renew(said) == LeaseAnswer(True)
    assert (job(platform_on, words.job_id).stage, job(platform_on, words.job_id).done) == ("frames", 3)
    with platform_on.database.transaction() as session:
        cancel(session, words.job_id, "wrong bag")
    assert line.renew(words).cancel_reason == "wrong bag"
    assert not line.renew(AttemptWords(other.job_id, 7)).is_held
    odd = AttemptWords(other.job_id, 1, lines=(AttemptLine(0, "info", "odd", {"x": object()}, 1),))
    assert line.renew(odd).is_held, "what no message holds is said to the database itself"
    line.close()


def test_without_a_keeper_that_answers_a_process_beats_for_itself(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    (words,) = claimed(platform_on, 1)
    monkeypatch.setattr(lease_keeper, "_ADDRESS", [f"\0stone-nobody-{token_hex(8)}"])
    line = LeaseLine(platform_on.database, PATIENCE_S)
    assert line.renew(words) == LeaseAnswer(True)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as deaf:
        deaf.bind(name := f"\0stone-deaf-{token_hex(8)}")
        deaf.listen()
        monkeypatch.setattr(lease_keeper, "_ADDRESS", [name])
        assert LeaseLine(platform_on.database, 0.1).renew(words) == LeaseAnswer(True)
    assert job(platform_on, words.job_id).heartbeats == 2


@pytest.mark.usefixtures("address")
def test_a_database_that_is_away_is_told_and_asked_again(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    (words,) = claimed(platform_on, 1)
    away, line = Away(monkeypatch), LeaseLine(platform_on.database, PATIENCE_S)
    away.error = GONE
    with refused_as("lease_not_renewed", match="connection refused"):
        line.renew(words)
    away.error = None
    assert line.renew(words) == LeaseAnswer(True)
    line.close()


def test_whoever_ends_waits_for_no_answer(platform_on: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    (words,) = claimed(platform_on, 1)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as deaf:
        deaf.bind(name := f"\0stone-deaf-{token_hex(8)}")
        deaf.listen()
        monkeypatch.setattr(lease_keeper, "_ADDRESS", [name])
        line, ended = LeaseLine(platform_on.database, 10 * PATIENCE_S), Event()

        def speak() -> None:
            with pytest.raises(EOFError):
                line.renew(words)
            ended.set()

        thread = Thread(target=speak)
        thread.start()
        connected, _ = deaf.accept()
        connected.recv(1)
        line.interrupt()
        assert ended.wait(PATIENCE_S)
        thread.join()
        connected.close()
        line.close()
    assert job(platform_on, words.job_id).heartbeats == 0


def test_who_talks_nonsense_is_dropped_and_the_others_are_served(platform_on: Platform, address: str) -> None:
    (words,) = claimed(platform_on, 1)
    for nonsense in (b"\xff" * 8, b"\0\0\0\2{}", b"\0\0\0\1["):
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as stranger:
            stranger.settimeout(PATIENCE_S)
            stranger.connect(address)
            stranger.sendall(nonsense)
            assert stranger.recv(1) == b""
    line = LeaseLine(platform_on.database, PATIENCE_S)
    assert line.renew(words) == LeaseAnswer(True)
    line.close()


@pytest.mark.skipif(os.geteuid() != 0, reason="only root becomes somebody else")
def test_who_is_of_another_user_is_not_heard(platform_on: Platform, address: str) -> None:
    (words,) = claimed(platform_on, 1)
    if (stranger := os.fork()) == 0:
        outcome = 1
        try:
            os.setuid(65534)
            stream = opened(address, PATIENCE_S)
            with suppress(OSError):
                stream.send(message_of(words))
            try:
                stream.first()
            except (EOFError, OSError):
                outcome = 0
        finally:
            os._exit(outcome)
    _, status = os.waitpid(stranger, 0)
    assert (status, job(platform_on, words.job_id).heartbeats) == (0, 0)


def present(platform: Platform) -> dict[str, int]:
    """Beats by name of process."""
    with platform.database.reading() as session:
        return {row.name: row.beats for row in session.scalars(select(Worker))}


@pytest.mark.usefixtures("address")
def test_processes_are_told_of_together_and_what_they_counted_is_summed(platform_on: Platform) -> None:
    counted = [{LEASES_EXPIRED.name: {"ingest.ok": amount}} for amount in (2.0, 3.0)]
    lines = [PresenceLine(PATIENCE_S) for _ in counted]
    there = [ProcessPresence(f"host:{number}", "ingest", 1, 10, 20, 30, 40, 50) for number in range(2)]
    for line, one, counts in zip(lines, there, counted, strict=True):
        assert line.tell(one, counts)  # type: ignore[arg-type]
    until(lambda: present(platform_on) == {"host:0": 1, "host:1": 1})
    with platform_on.database.reading() as session:
        assert counters_of_all_processes(session) == {LEASES_EXPIRED.name: {"ingest.ok": 5.0}}
        assert len(session.scalars(select(CounterRow)).all()) == 1
    assert lines[0].tell(there[0], {})
    until(lambda: present(platform_on) == {"host:0": 2, "host:1": 1})
    for line in lines:
        line.close()


@pytest.mark.usefixtures("address")
def test_whoever_left_is_told_of_no_more(platform_on: Platform) -> None:
    heartbeat = WorkerHeartbeat(platform_on, ["ingest"])
    heartbeat.start()
    until(lambda: len(present(platform_on)) == 1)
    heartbeat.tell()
    heartbeat.leave()
    other = PresenceLine(PATIENCE_S)
    assert other.tell(ProcessPresence("host:other", "ingest", 1, 10, 20, 30, 40, 50), {})
    until(lambda: "host:other" in present(platform_on))  # a turn writes all who are there
    other.close()
    assert present(platform_on) == {"host:other": 1}


def test_without_a_keeper_a_process_tells_of_itself_and_nothing_is_counted_twice(
    platform_on: Platform, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = process_counters().counts().get(LEASES_EXPIRED.name, {}).get("ingest.alone", 0.0)
    heartbeat = WorkerHeartbeat(platform_on, ["ingest"])
    process_counters().add(LEASES_EXPIRED, ("ingest.alone",))
    heartbeat.tell()
    until(lambda: list(present(platform_on).values()) == [1])
    monkeypatch.setattr(lease_keeper, "_ADDRESS", [f"\0stone-nobody-{token_hex(8)}"])
    process_counters().add(LEASES_EXPIRED, ("ingest.alone",))
    heartbeat._line.close()
    heartbeat.tell()
    assert list(present(platform_on).values()) == [2]
    with platform_on.database.reading() as session:
        total = counters_of_all_processes(session)[LEASES_EXPIRED.name]["ingest.alone"]
    assert total == before + 2


@pytest.mark.whole
def test_a_keeper_is_a_process_that_ends_with_its_worker_and_by_no_lesser_signal(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches alone a keeper that outlives its worker, or that the signal a machine sends to all ends too early."""
    monkeypatch.setattr(lease_keeper, "_ADDRESS", [])
    (words,) = claimed(platform, 1)
    platform.database.close()  # as a worker's parent has none open when it forks
    told, tell = os.pipe()
    if (worker := os.fork()) == 0:
        try:
            keeper = start_keeper(platform.settings)
            is_held = LeaseLine(platform.database, PATIENCE_S)._request(words).is_held
            os.write(tell, f"{keeper} {is_held}".encode())
            signal.pause()
        finally:
            os._exit(0)
    os.close(tell)
    pid, is_held = os.read(told, 100).decode().split()
    assert is_held == "True"
    os.kill(int(pid), signal.SIGTERM)
    time.sleep(0.2)
    assert is_running(int(pid))
    os.kill(worker, signal.SIGKILL)
    os.waitpid(worker, 0)
    until(lambda: not is_running(int(pid)))
    os.close(told)
