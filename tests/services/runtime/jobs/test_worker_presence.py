"""Worker processes tell that they are there, on both databases; who falls silent is shown so, then forgotten."""

import os
import resource
import time
from pathlib import Path

import pytest
from sqlalchemy import select, update

from services.runtime.database.clock import database_ns
from services.runtime.jobs.claims import worker_name
from services.runtime.jobs.worker_presence import WorkerHeartbeat, forget_silent, workers_seen
from services.runtime.orm import Worker
from services.runtime.platform import Platform
from services.runtime.telemetry.process_usage import ProcessUsage, Room, disk, held_bytes, memory, usage_of

MIB = 2**20
HEARTBEAT_S = 4.0


def age(platform: Platform, seconds: float) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Worker).values(beat_ns=Worker.beat_ns - int(seconds * 1e9)))


def test_a_process_tells_what_it_is_and_what_its_machine_has_left(platform_on: Platform) -> None:
    presence = WorkerHeartbeat(platform_on, ["labeler", "ingest"])
    presence.tell()
    presence.tell()
    with platform_on.database.reading() as session:
        (seen,) = workers_seen(session, HEARTBEAT_S, 10)
    row = seen.worker
    assert (row.name, row.queues, row.beats, seen.is_silent) == (worker_name(), "ingest,labeler", 2, False)
    assert row.held_bytes is not None
    assert row.held_bytes > MIB
    for free, total in ((row.memory_free_bytes, row.memory_bytes), (row.disk_free_bytes, row.disk_bytes)):
        assert free is not None
        assert total is not None
        assert 0 < free <= total


def test_whoever_missed_its_heartbeats_is_silent_and_forgotten_later(platform_on: Platform) -> None:
    WorkerHeartbeat(platform_on, ["eval"]).tell()
    age(platform_on, 60.0)
    with platform_on.database.reading() as session:
        (seen,) = workers_seen(session, HEARTBEAT_S, 10)
    assert seen.is_silent
    assert 59.0 < seen.age_s < 120.0
    assert forget_silent(platform_on, older_than_s=3600.0) == 0
    assert forget_silent(platform_on, older_than_s=30.0) == 1


def test_the_databases_clock_agrees_with_ours_on_one_machine(platform_on: Platform) -> None:
    with platform_on.database.reading() as session:
        told = session.scalar(select(database_ns()))
    assert told is not None
    assert abs(told - time.time_ns()) < 60 * 10**9


def test_a_pid_that_comes_round_again_begins_anew(platform: Platform) -> None:
    WorkerHeartbeat(platform, ["eval"]).tell()
    WorkerHeartbeat(platform, ["ingest"]).tell()
    with platform.database.reading() as session:
        row = session.scalars(select(Worker)).one()
    assert (row.queues, row.beats) == ("ingest", 1)


@pytest.mark.parametrize(
    ("limit", "used", "expected"),
    [
        ("max", "5", Room(600 * MIB, 1000 * MIB)),
        (str(2000 * MIB), "0", Room(600 * MIB, 1000 * MIB)),
        (str(400 * MIB), str(100 * MIB), Room(300 * MIB, 400 * MIB)),
        (str(900 * MIB), str(100 * MIB), Room(600 * MIB, 900 * MIB)),
        (str(400 * MIB), str(500 * MIB), Room(0, 400 * MIB)),
    ],
)
def test_a_container_has_what_is_less(tmp_path: Path, limit: str, used: str, expected: Room) -> None:
    (tmp_path / "meminfo").write_text(f"MemTotal: {1000 * 1024} kB\nMemAvailable: {600 * 1024} kB\n", "ascii")
    (tmp_path / "memory.max").write_text(limit + "\n", "ascii")
    (tmp_path / "memory.current").write_text(used + "\n", "ascii")
    assert memory(tmp_path, tmp_path) == expected


def test_what_cannot_be_read_is_unknown(tmp_path: Path) -> None:
    assert memory(tmp_path, tmp_path) == Room()
    assert held_bytes(tmp_path) is None


def test_a_folder_that_is_not_made_yet_is_on_the_disk_it_will_be_on(tmp_path: Path) -> None:
    assert disk(tmp_path / "not" / "yet").total_bytes == disk(tmp_path).total_bytes


TICK_S = 0.01


def test_a_process_is_told_what_it_knows_of_itself() -> None:
    before_s = time.process_time()
    used = usage_of(os.getpid())
    assert before_s - 2 * TICK_S <= used.cpu_s <= time.process_time() + 2 * TICK_S
    assert used.held_bytes == pytest.approx(held_bytes(), rel=0.2)
    assert used.held_bytes <= used.peak_bytes
    assert used.peak_bytes == pytest.approx(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024, rel=0.2)


def test_of_a_process_that_ended_nothing_is_known(tmp_path: Path) -> None:
    assert usage_of(1, tmp_path) == ProcessUsage()
