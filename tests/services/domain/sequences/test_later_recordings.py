"""Recordings that are added to a labelled sequence: it is processed again once, whatever happens in between."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from sqlalchemy import select

from services.domain.sequences import later_recordings as module
from services.domain.sequences.later_recordings import (
    LaterRecordings,
    SequenceWalk,
    follow_recordings,
    later_recordings,
)
from services.domain.sequences.processing import PROCESS, register
from services.domain.sequences.recordings import remove_recording
from services.runtime.jobs.control import set_mode
from services.runtime.orm import Job, LabelSet, Recording, SequenceRow
from services.runtime.platform import Platform
from testing.worlds.runs import Brought, bring
from tests.services.domain.sequences.test_processing import ended, ready_on, with_recording
from tests.services.runtime.jobs.steps import act

CAMERAS, RADAR = ("cameras.mcap", "cd" * 32), ("radar.bag", "ef" * 32)


@pytest.fixture
def labelled(platform: Platform, tmp_path: Path) -> Brought:
    return labelled_on(platform, tmp_path)


def labelled_on(platform: Platform, tmp_path: Path) -> Brought:
    """A sequence of one recording with labels."""
    brought = ready_on(platform, tmp_path)
    ended(brought, brought.process(profile="local", parameters={"reference.alpha": 0.1}))
    return brought


def runs(brought: Brought) -> list[Job]:
    with brought.platform.database.reading() as session:
        return list(session.scalars(select(Job).where(Job.kind == PROCESS).order_by(Job.id)))


def said(brought: Brought) -> LaterRecordings | None:
    with brought.platform.database.reading() as session:
        sequence = session.get_one(SequenceRow, brought.sequence_id)
        newest = session.scalars(select(LabelSet).order_by(LabelSet.id.desc()).limit(1)).one()
        return later_recordings(session, sequence, newest)


def follow(brought: Brought) -> int:
    return follow_recordings(brought.platform)


def test_a_recording_that_is_added_has_the_sequence_processed_again_as_last_time(labelled: Brought) -> None:
    assert (follow(labelled), said(labelled)) == (0, None)
    with_recording(labelled, "registered", *CAMERAS)
    assert said(labelled) == LaterRecordings(("cameras.mcap",))
    assert (follow(labelled), follow(labelled)) == (1, 0)
    _, again = runs(labelled)
    assert again.arguments["recording_ids"] == labelled.recording_ids
    assert (again.arguments["profile"], again.arguments["parameters"]) == ("local", {"reference.alpha": 0.1})
    assert said(labelled) == LaterRecordings(("cameras.mcap",))
    ended(labelled, again.id)
    assert (follow(labelled), said(labelled)) == (0, None)


def test_of_recordings_that_are_added_at_once_one_run_is_made(platform_on: Platform, tmp_path: Path) -> None:
    labelled = labelled_on(platform_on, tmp_path)
    with_recording(labelled, "registered", *CAMERAS)
    with_recording(labelled, "received", *RADAR)
    reading = act(labelled.platform, register, labelled.recording(2))
    assert follow(labelled) == 0
    with labelled.platform.database.transaction() as session:
        session.get_one(Job, reading.id).state = "succeeded"
        session.get_one(Recording, labelled.recording_ids[2]).state = "registered"
    with ThreadPoolExecutor(4) as sweepers:
        started = list(sweepers.map(lambda _: follow(labelled), range(8)))
    assert sum(started) == 1
    assert len(runs(labelled)) == 2
    assert len(runs(labelled)[1].arguments["recording_ids"]) == 3


@pytest.mark.parametrize("end", ["refused", "cancelled", "failed", "removed"])
def test_however_the_reading_of_another_ends_the_one_that_was_registered_is_taken(labelled: Brought, end: str) -> None:
    with_recording(labelled, "registered", *CAMERAS)
    with_recording(labelled, "received", *RADAR)
    reading = act(labelled.platform, register, labelled.recording(2))
    assert follow(labelled) == 0
    with labelled.platform.database.transaction() as session:
        other = session.get_one(Recording, labelled.recording_ids[2])
        if end == "removed":
            remove_recording(session, other)
        else:
            session.get_one(Job, reading.id).state = "failed" if end == "refused" else end
            other.state = "refused" if end == "refused" else "received"
    assert (follow(labelled), follow(labelled)) == (1, 0)
    assert runs(labelled)[1].arguments["recording_ids"] == labelled.recording_ids[:2]


def refused(brought: Brought) -> None:
    with_recording(brought, "refused", *CAMERAS)


def sent_again(brought: Brought) -> None:
    with_recording(brought)


def unlabelled(brought: Brought) -> None:
    with brought.platform.database.transaction() as session:
        session.delete(session.scalars(select(LabelSet)).one())
    with_recording(brought, "registered", *CAMERAS)


def deleted(brought: Brought) -> None:
    with_recording(brought, "registered", *CAMERAS)
    with brought.platform.database.transaction() as session:
        session.get_one(SequenceRow, brought.sequence_id).deleted_ns = 1


def meant_by_name(brought: Brought) -> None:
    ended(brought, brought.process(recording_ids=(brought.recording_ids[0],), profile="paper"))
    with_recording(brought, "registered", *CAMERAS)


def taken_in_vain(brought: Brought) -> None:
    with_recording(brought, "registered", *CAMERAS)
    assert follow(brought) == 1
    ended(brought, runs(brought)[-1].id, "failed")


def at_work(brought: Brought) -> None:
    brought.process(profile="paper")
    with_recording(brought, "registered", *CAMERAS)


@pytest.mark.parametrize("happen", [refused, sent_again, unlabelled, deleted, meant_by_name, taken_in_vain, at_work])
def test_nothing_is_processed_again_where(labelled: Brought, happen: Callable[[Brought], None]) -> None:
    happen(labelled)
    before = len(runs(labelled))
    assert (follow(labelled), follow(labelled)) == (0, 0)
    assert len(runs(labelled)) == before


def test_a_recording_that_comes_while_a_run_is_at_work_is_taken_by_the_next(labelled: Brought) -> None:
    at_work(labelled)
    ended(labelled, runs(labelled)[-1].id)
    assert follow(labelled) == 1
    assert runs(labelled)[-1].arguments["recording_ids"] == labelled.recording_ids
    assert runs(labelled)[-1].arguments["profile"] == "paper"


def test_what_keeps_a_run_from_starting_is_said_and_it_starts_once_that_is_gone(labelled: Brought) -> None:
    with_recording(labelled, "registered", "run.mcap", "cd" * 32)
    assert follow(labelled) == 0
    shown = said(labelled)
    assert shown.why_not
    with labelled.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, labelled.recording_ids[0]))
    with_recording(labelled, "registered", *CAMERAS)
    assert follow(labelled) == 1


def test_a_draining_queue_is_waited_for(labelled: Brought) -> None:
    with_recording(labelled, "registered", *CAMERAS)
    act(labelled.platform, set_mode, "ingest", "draining")
    assert follow(labelled) == 0
    act(labelled.platform, set_mode, "ingest", "open")
    assert follow(labelled) == 1


def test_labels_that_an_earlier_version_made_know_their_recording(labelled: Brought) -> None:
    with labelled.platform.database.transaction() as session:
        run = session.scalars(select(Job).where(Job.kind == PROCESS)).one()
        kept = {name: run.arguments[name] for name in run.arguments if not name.startswith("recording_")}
        run.arguments = {**kept, "recording_id": labelled.recording_ids[0]}
    assert said(labelled) is None
    with_recording(labelled, "registered", *CAMERAS)
    assert follow(labelled) == 1


def test_every_sequence_has_its_turn(platform: Platform, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(module, "AT_A_TIME", 3)
    rig = tmp_path / "rig.yaml"
    rig.write_text("stone_calibration: 1\n")
    for number in range(4):
        brought = bring(platform, f"n{number}")
        brought.calibrate(rig)
        with_recording(brought)
        ended(brought, brought.process())
        with_recording(brought, "registered", *CAMERAS)
    walk = SequenceWalk()
    assert sum(follow_recordings(platform, walk) for _ in range(8)) == 4
    assert follow_recordings(platform, walk) == 0
