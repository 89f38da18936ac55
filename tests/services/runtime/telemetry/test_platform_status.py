"""How things stand, on both databases: what waits, since when, who works, what was swept; found by steps, not scans."""

import pytest
from sqlalchemy import update

from benchmarks.rows.plans import explained, record_statements
from services.maintenance.sweeper import Chore, ChoreLoop, recorded
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.specs import JobSpec
from services.runtime.jobs.worker_presence import WorkerHeartbeat
from services.runtime.orm import Blob, Job
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.telemetry import platform_status as standing_module
from services.runtime.telemetry.platform_status import PlatformStatus, platform_status
from services.runtime.telemetry.sweeper_statistics import STORED_BLOBS, STORED_BYTES, ChoreLedger, StoreSum
from tests.services.runtime.jobs.steps import a_job, a_run, an_owner, run_all


def standing_of(platform: Platform) -> PlatformStatus:
    with platform.database.reading() as session:
        return platform_status(session, heartbeat_s=4.0)


def test_jobs_are_ready_waiting_or_running(platform: Platform) -> None:
    owner = an_owner(platform)
    a_run(platform, owner, JobSpec("ingest.ok", key="first"), JobSpec("labeler.ok", needs=("first",)))
    a_job(platform, owner)
    with platform.database.transaction() as session:
        assert claim(session, "ingest")
    jobs = standing_of(platform).jobs
    assert {key: count for key, count in jobs.items() if count} == {
        ("ingest", "ready"): 1,
        ("ingest", "running"): 1,
        ("labeler", "waiting"): 1,
    }
    assert ("eval", "ready") in jobs


def test_a_queue_is_as_old_as_its_oldest_ready_job_is_ready(platform_on: Platform) -> None:
    owner = an_owner(platform_on)
    a_run(platform_on, owner, JobSpec("ingest.ok", key="first"), JobSpec("labeler.ok", needs=("first",)))
    an_hour_ago_ns = now_ns() - 3600 * 10**9
    with platform_on.database.transaction() as session:
        session.execute(update(Job).where(Job.queue != "").values(created_ns=an_hour_ago_ns))
        session.execute(update(Job).where(Job.queue == "ingest").values(ready_ns=an_hour_ago_ns))
    before = standing_of(platform_on).oldest_ready_s
    assert 3600.0 <= before["ingest"] < 3700.0
    assert (before["labeler"], before["eval"]) == (0.0, 0.0)
    while run_all(platform_on):
        pass
    a_run(platform_on, owner, JobSpec("labeler.ok"))
    assert 0.0 <= standing_of(platform_on).oldest_ready_s["labeler"] < 600.0  # not since its run was made


def test_nothing_is_counted_beyond_what_is_worth_counting(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(standing_module, "MOST", 2)
    owner = an_owner(platform)
    for _ in range(4):
        a_job(platform, owner)
    assert standing_of(platform).jobs["ingest", "ready"] == 2


def test_workers_queues_and_chores_are_told(platform: Platform) -> None:
    WorkerHeartbeat(platform, ["eval"]).tell()
    with platform.database.transaction() as session:
        set_mode(session, "labeler", "paused")
    ledger = ChoreLedger(platform)
    for _ in range(2):
        ledger.note("jobs")
        ledger.write()
    now = standing_of(platform)
    assert [one.worker.queues for one in now.workers] == ["eval"]
    assert now.paused == {"labeler"}
    assert 0.0 <= now.chores_s["jobs"] < 60.0


def test_a_chore_that_was_not_done_is_not_written_down(platform: Platform) -> None:
    def away() -> None:
        raise OSError(28, "No space left on device")

    done, not_done = (Chore("jobs", 1.0, lambda: None), Chore("uploads", 1.0, away))
    loops = recorded(platform, (ChoreLoop("jobs", (done,)), ChoreLoop("cleaning", (not_done,))))
    assert [chore.run_if_due(0.0) for loop in loops for chore in loop.chores] == [True, False, True, True, True]
    assert set(standing_of(platform).chores_s) == {"jobs", "size of the store", "counts"}


def test_what_the_store_holds_is_added_up_in_steps(platform: Platform) -> None:
    with platform.database.transaction() as session:
        for number in range(5):
            session.add(Blob(sha256=f"{number:064x}", object_key=f"blobs/{number}", size_bytes=10**number))
    stored = StoreSum(platform)
    stored.step(most=2)
    stored.step(most=2)
    assert not standing_of(platform).figures
    stored.step(most=2)
    assert standing_of(platform).figures == {STORED_BYTES: 11111, STORED_BLOBS: 5}


def test_every_question_about_jobs_is_answered_off_an_index(on_postgres: Platform) -> None:
    with record_statements(on_postgres.database.engine) as statements:
        standing_of(on_postgres)
    with on_postgres.database.engine.connect() as connection:
        connection.exec_driver_sql("SET enable_seqscan = off")
        asked = [one for one in statements if one.is_explained]
        plans = [explained(connection, one, frozenset({"jobs"}), is_run=False) for one in asked]
    assert [plan.faults for plan in plans if plan.faults] == []
    used = {index for plan in plans for index in plan.indexes}
    assert {"ix_jobs_ready_since", "ix_jobs_waiting", "ix_jobs_running"} <= used
