"""What estimates read of runs, on both databases: by statements whose values no type converts."""

from typing import Any

import pytest
from sqlalchemy.orm import Session

from services.domain.runs.estimates import alive_rows, alive_runs, older_of_the_same, pace_of, queue_facts
from services.domain.runs.time_left import LABELLING, Pace, RunningJob, RunWorkload, StageWork
from services.runtime.orm import Job, LabelSet, Recording, SequenceRow, new_id
from services.runtime.platform import Platform
from testing.api.serving import Person, person

SECOND = 10**9
NOW = 1000 * SECOND


@pytest.fixture
def ada(platform_on: Platform) -> Person:
    return person(platform_on, "curator")


def sequence_of(session: Session, owner: Person) -> SequenceRow:
    row = SequenceRow(id=new_id(), owner_id=owner.user_id, name="forest")
    session.add(row)
    session.flush()
    return row


def run_of(session: Session, sequence: SequenceRow, state: str, **columns: Any) -> Job:
    run = Job(id=new_id(), owner_id=sequence.owner_id, sequence_id=sequence.id, kind=LABELLING, state=state, **columns)
    run.root_id = run.id
    session.add(run)
    session.flush()
    return run


def job_of(session: Session, run: Job, kind: str, state: str, **columns: Any) -> None:
    held = {"root_id": run.id, "owner_id": run.owner_id, "sequence_id": run.sequence_id}
    session.add(Job(kind=kind, queue=kind.partition(".")[0], state=state, **held, **columns))
    session.flush()


def recording_of(session: Session, sequence: SequenceRow, inspection: dict[str, Any] | None) -> str:
    told = {"filename": "run.mcap", "size_bytes": 1, "sha256": "0" * 64, "inspection": inspection}
    row = Recording(id=new_id(), sequence_id=sequence.id, **told)
    session.add(row)
    session.flush()
    return row.id


def test_a_labelling_is_read_with_its_recordings_frames_and_jobs(platform_on: Platform, ada: Person) -> None:
    with platform_on.database.transaction() as session:
        sequence = sequence_of(session, ada)
        told = [{"duration_ns": 7 * SECOND}, {"duration_ns": 5 * SECOND}, {}, None]
        made_of = [recording_of(session, sequence, inspection) for inspection in told]
        arguments = {"recording_ids": made_of}
        run = run_of(session, sequence, "running", arguments=arguments)
        lasted = {"started_ns": NOW - 9 * SECOND, "finished_ns": NOW - 6 * SECOND}
        job_of(session, run, "ingest.synchronise", "succeeded", result={"frames": 120}, **lasted)
        job_of(session, run, "labeler.fuse", "running", started_ns=NOW - 2 * SECOND, done=15, total=60)
        job_of(session, run, "labeler.fuse", "queued")
        (alive,) = alive_runs(session, alive_rows(session, [run.id]), NOW)
    fuse = StageWork("labeler.fuse", queued=1, running=(RunningJob(2.0, 0.25),))
    stages = (StageWork("ingest.synchronise", done=1, busy_s=3.0), fuse)
    assert alive.work == RunWorkload(LABELLING, stages, recorded_s=12.0, frames=120)
    assert (alive.queue, alive.is_paused) == ("labeler", False)


def test_only_runs_that_have_not_ended_are_read_and_of_the_older_the_newest_first(
    platform_on: Platform, ada: Person
) -> None:
    eve = person(platform_on, "curator")
    with platform_on.database.transaction() as session:
        sequence, other = sequence_of(session, ada), sequence_of(session, eve)
        runs = [run_of(session, sequence, state) for state in ("queued", "failed", "running", "queued", "queued")]
        run_of(session, other, "queued")
        job_of(session, runs[3], "labeler.fuse", "queued")
        ids = [run.id for run in runs]
        assert {row.id for row in alive_rows(session, ids)} == {ids[0], *ids[2:]}
        before = older_of_the_same(session, alive_rows(session, [ids[3]]))
    assert [row.id for row in before] == [ids[2], ids[0]]


def test_a_queue_is_shared_with_owners_who_work_or_wait_there_and_are_no_less_urgent(
    platform_on: Platform, ada: Person
) -> None:
    others = [person(platform_on, "curator") for _ in range(5)]
    at_work = ((0,), (2, 5, 0), (9,), (), ())
    with platform_on.database.transaction() as session:
        runs = [run_of(session, sequence_of(session, owner), "running") for owner in (*others, ada)]
        for run, urgencies in zip(runs, at_work, strict=False):
            for priority in urgencies:
                job_of(session, run, "labeler.fuse", "running", priority=priority)
        job_of(session, runs[2], "ingest.check", "running")
        job_of(session, runs[3], "labeler.fuse", "queued", priority=5)
        job_of(session, runs[4], "labeler.fuse", "queued", priority=9, needs_left=1)
        job_of(session, runs[5], "labeler.fuse", "running", priority=9)
        facts = queue_facts(session, [("labeler", 0), ("labeler", 5), ("ingest", 0), ("labeler", 0)])
    told = {asked: {owner.user_id for owner in others} & rivals for asked, rivals in facts.rivals.items()}
    ids = [owner.user_id for owner in others]
    assert told == {("labeler", 0): set(ids[:4]), ("labeler", 5): set(ids[1:4]), ("ingest", 0): {ids[2]}}
    assert [facts.share("labeler", ada.user_id, urgency) for urgency in (0, 5)] == [1 / 5, 1 / 4]
    assert facts.share("labeler", ids[0], 0) == 1 / 5
    assert facts.share("labeler", ids[0], 5) == 1 / 5


def test_the_pace_is_that_of_jobs_which_succeeded_in_the_last_runs_that_did(platform_on: Platform, ada: Person) -> None:
    with platform_on.database.transaction() as session:
        sequence = sequence_of(session, ada)
        for number, state in enumerate(("succeeded", "failed", "succeeded", "running")):
            run = run_of(session, sequence, state)
            for kind, took_s in (("ingest.synchronise", 4), ("labeler.fuse", 2 + number), ("labeler.surface", 6)):
                job_of(session, run, kind, "succeeded", started_ns=SECOND, finished_ns=(1 + took_s) * SECOND)
            job_of(session, run, "labeler.surface", "failed", started_ns=SECOND, finished_ns=90 * SECOND)
            job_of(session, run, "labeler.surface", "succeeded")  # of a release that did not say when
            labels = {"parameters": {}, "code_version": "1", "frames": 1, "duration_ns": 8 * SECOND * (number + 1)}
            session.add(LabelSet(sequence_id=sequence.id, job_id=run.id, recipe=f"{number}" * 64, **labels))
        session.flush()
        pace = pace_of(session, LABELLING)
    assert pace == Pace({"labeler.fuse": 3.0, "labeler.surface": 6.0, "ingest.synchronise": 8 / 32}, tiles_per_part=1.0)
