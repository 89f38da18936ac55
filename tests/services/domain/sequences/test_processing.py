"""What an owner may have done to a sequence: refused with its reason, done once however often it is asked for."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import func, select

from api.visible import newest_label_set
from services.domain.sequences.label_choices import ChoiceError
from services.domain.sequences.processing import (
    PROCESS,
    ProcessRequest,
    delete_sequence,
    register,
    start_processing,
)
from services.domain.sequences.processing_errors import (
    AlreadyProcessingError,
    NoCalibrationError,
    NoRecordingError,
    RecordingPendingError,
    SequenceDeletedError,
    SeveralRecordingsError,
    UnknownStagesError,
)
from services.domain.sequences.profiles import keep_profile
from services.runtime.access import storage_quota
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import cancel
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Job, LabelSet, ProfileRow, QuotaEntry, Recording, SequenceRow, Upload
from services.runtime.platform import Platform
from testing.worlds.rows import recording_of
from testing.worlds.runs import Brought, bring


def with_recording(brought: Brought, state: str = "registered") -> None:
    with brought.platform.database.transaction() as session:
        facts: dict[str, Any] = {"purpose": "recording", "filename": "run.mcap", "length_bytes": 7}
        upload = Upload(owner_id=brought.owner_id, state="consumed", expires_ns=0, **facts)
        session.add(upload)
        session.flush()
        storage_quota.reserve(session, brought.owner_id, 7, upload.id, "upload", 100)
        upload.sha256 = "ab" * 32
        recording = recording_of(upload, brought.sequence_id, state)
        session.add(recording)
        session.flush()
        brought.recording_ids.append(recording.id)


@pytest.fixture
def ready(platform_on: Platform, tmp_path: Path) -> Brought:
    return ready_on(platform_on, tmp_path)


def ready_on(platform: Platform, tmp_path: Path) -> Brought:
    """A sequence that can be processed."""
    brought = bring(platform)
    rig = tmp_path / "rig.yaml"
    rig.write_text("stone_calibration: 1\n")
    brought.calibrate(rig)
    with_recording(brought)
    return brought


def test_what_is_missing_is_said_in_the_order_in_which_it_is_given(platform_on: Platform, tmp_path: Path) -> None:
    brought = bring(platform_on)
    with pytest.raises(NoCalibrationError):
        brought.process()
    (tmp_path / "rig.yaml").write_text("stone_calibration: 1\n")
    brought.calibrate(tmp_path / "rig.yaml")
    with pytest.raises(NoRecordingError, match="none was added"):
        brought.process()
    with_recording(brought, "refused")
    with pytest.raises(NoRecordingError, match="1 could not be registered"):
        brought.process()
    with_recording(brought, "received")
    with platform_on.database.transaction() as session:
        job = register(session, brought.recording(1))
    with pytest.raises(RecordingPendingError, match="1 recordings"):
        brought.process()
    with platform_on.database.transaction() as session:
        cancel(session, job.id, "")
    with pytest.raises(NoRecordingError, match="2 could not be registered"):
        brought.process()


def test_two_bags_are_not_merged_by_chance(ready: Brought) -> None:
    with_recording(ready)
    with pytest.raises(SeveralRecordingsError, match="2 registered recordings and 1 can be processed"):
        ready.process()


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        ({"profile": "mine"}, "'profile' cannot be 'mine'; a profile is one of paper, local"),
        ({"parameters": {"surface.width_m": 0.001}}, "the parameters that can be chosen are"),
        ({"parameters": {"reference.alpha": 0.9}}, "it lies between 0.0001 and 0.5"),
        ({"parameters": {"reference.alpha": float("nan")}}, "it lies between"),
        ({"parameters": {"reference.alpha": True}}, "it takes a number"),
        ({"parameters": {"reference.alpha": "0.05"}}, "it takes a number"),
        ({"parameters": {"terrain.neighbours": 20.5}}, "it takes a whole number from 8 to 64"),
    ],
)
def test_choices_out_of_bounds_are_refused_by_name(platform: Platform, request_: dict[str, Any], reason: str) -> None:
    with pytest.raises(ChoiceError, match=reason):
        bring(platform).process(**request_)


@pytest.mark.parametrize("stages", [(), ("label",), ("synchronise", "labels"), ("label", "synchronise")])
def test_stages_begin_at_the_first(platform: Platform, stages: tuple[str, ...]) -> None:
    with pytest.raises(UnknownStagesError, match="ask for synchronise, or for synchronise and label"):
        bring(platform).process(stages=stages)


def test_equal_requests_are_one_run_and_another_is_told_its_id(ready: Brought) -> None:
    root_id = ready.process(parameters={"reference.alpha": 0.1, "surface.min_frames": 2})
    assert ready.process(parameters={"surface.min_frames": 2, "reference.alpha": 0.1}) == root_id
    with pytest.raises(AlreadyProcessingError, match=root_id) as refused:
        ready.process()
    assert refused.value.job_id == root_id
    with ready.platform.database.transaction() as session:
        cancel(session, root_id, "")
    assert ready.process() != root_id


def test_requests_at_once_give_one_run(ready: Brought) -> None:
    with ThreadPoolExecutor(8) as pool:
        started = set(pool.map(lambda _: ready.process(), range(16)))
    assert len(started) == 1
    with ready.platform.database.reading() as session:
        assert session.scalar(select(func.count()).where(Job.kind == PROCESS)) == 1


def test_a_run_that_was_cancelled_but_still_stops_is_not_joined(ready: Brought) -> None:
    root_id = ready.process()
    with ready.platform.database.transaction() as session:
        assert claim(session, "ingest") is not None
        cancel(session, root_id, "")
    with pytest.raises(AlreadyProcessingError):
        ready.process()


def test_what_was_made_is_answered_with_the_run_that_made_it(ready: Brought) -> None:
    root_id = ready.process()
    recipe = ready.job(root_id).arguments["recipe"]
    with ready.platform.database.transaction() as session:
        cancel(session, root_id, "")
        row = LabelSet(sequence_id=ready.sequence_id, job_id=root_id, recipe=recipe, parameters={})
        row.code_version, row.frames = "0", 1
        session.add(row)
    assert ready.process() == root_id
    assert ready.process(profile="local") != root_id


def test_of_several_label_sets_the_one_asked_for_last_counts(ready: Brought) -> None:
    for alpha in (0.1, 0.2):
        root_id = ready.process(parameters={"reference.alpha": alpha})
        with ready.platform.database.transaction() as session:
            cancel(session, root_id, "")
            recipe = session.get_one(Job, root_id).arguments["recipe"]
            row = LabelSet(sequence_id=ready.sequence_id, job_id=root_id, recipe=recipe, parameters={"alpha": alpha})
            row.code_version, row.frames = "0", 1
            session.add(row)
    ready.process(parameters={"reference.alpha": 0.1})
    with ready.platform.database.reading() as session:
        counts = newest_label_set(session, ready.sequence_id)
    assert counts.parameters == {"alpha": 0.1}


def test_a_deleted_sequence_has_nothing_left_and_takes_nothing_new(ready: Brought) -> None:
    root_id = ready.process()
    stale = ready.sequence()
    with ready.platform.database.transaction() as session:
        delete_sequence(session, stale)
    assert ready.job(root_id).state == "cancelled"
    assert ready.sequence().deleted_ns is not None
    with ready.platform.database.reading() as session:
        assert session.scalars(select(Recording)).all() == []
        assert session.scalar(select(func.sum(QuotaEntry.amount))) == 0
    for act in (delete_sequence, lambda session, sequence: start_processing(session, sequence, ProcessRequest())):
        with pytest.raises(SequenceDeletedError), ready.platform.database.transaction() as session:
            act(session, stale)


def test_deleting_and_starting_at_once_leave_no_run_alive(ready: Brought) -> None:
    def start() -> None:
        try:
            ready.process()
        except SequenceDeletedError:
            return

    def bury() -> None:
        with ready.platform.database.transaction() as session:
            delete_sequence(session, ready.sequence())

    with ThreadPoolExecutor(4) as pool:
        for done in [pool.submit(act) for act in (start, bury, start, start)]:
            done.result(timeout=300)
    with ready.platform.database.reading() as session:
        assert set(session.scalars(select(Job.state))) <= {"cancelled"}


def test_jobs_of_a_batch_are_taken_in_their_order(platform_on: Platform) -> None:
    brought = bring(platform_on)
    specs = [JobSpec("labeler.surface", {"tile": number}) for number in range(40)]
    with platform_on.database.transaction() as session:
        enqueue_run(session, PROCESS, specs, Context(brought.owner_id))
    taken = []
    for _ in specs:
        with platform_on.database.transaction() as session:
            claimed = claim(session, "labeler")
        assert claimed is not None
        taken.append(claimed.arguments["tile"])
    assert taken == list(range(40))


def test_the_profile_of_the_platform_is_what_a_run_is_made_with(ready: Brought) -> None:
    with ready.platform.database.transaction() as session:
        session.get_one(SequenceRow, ready.sequence_id).platform = "rover"
        session.add(ProfileRow(owner_id=ready.owner_id, platform="rover", topics={"pose": "/odom"}))
    run_id = ready.process()
    with ready.platform.database.reading() as session:
        assert session.get_one(Job, run_id).arguments["topics"] == {"pose": "/odom"}
    with ready.platform.database.transaction() as session:
        profile = session.scalars(select(ProfileRow)).one()
        keep_profile(session, profile, {"pose": "/other"})
    with pytest.raises(AlreadyProcessingError):
        ready.process()
