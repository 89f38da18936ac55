"""What an owner may have done to a sequence: refused with its reason, done once however often it is asked for."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import func, select

from api.visible import newest_label_set
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.domain.sequences.processing import (
    PROCESS,
    ProcessRequest,
    delete_sequence,
    register,
    request_of,
    start_processing,
)
from services.domain.sequences.processing_errors import (
    AlreadyProcessingError,
    RecordingPendingError,
    SequenceDeletedError,
)
from services.domain.sequences.profiles import keep_profile
from services.domain.sequences.recordings import remove_recording
from services.runtime.access import storage_quota
from services.runtime.jobs.claims import claim
from services.runtime.jobs.control import cancel
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import CalibrationRow, Job, LabelSet, ProfileRow, QuotaEntry, Recording, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.recipes import recipe_of
from testing.refusals import refused_as
from testing.worlds.rows import recording_of
from testing.worlds.runs import Brought, bring


def with_recording(
    brought: Brought, state: str = "registered", name: str = "run.mcap", sha256: str = "ab" * 32
) -> None:
    with brought.platform.database.transaction() as session:
        facts: dict[str, Any] = {"purpose": "recording", "filename": name, "length_bytes": 7}
        upload = Upload(owner_id=brought.owner_id, state="consumed", expires_ns=0, **facts)
        session.add(upload)
        session.flush()
        storage_quota.reserve(session, brought.owner_id, 7, upload.id, "upload", 100)
        upload.sha256 = sha256
        recording = recording_of(upload, brought.sequence_id, state)
        session.add(recording)
        session.flush()
        brought.recording_ids.append(recording.id)


@pytest.fixture
def ready(platform: Platform, tmp_path: Path) -> Brought:
    return ready_on(platform, tmp_path)


def ready_on(platform: Platform, tmp_path: Path) -> Brought:
    """A sequence that can be processed."""
    brought = bring(platform)
    rig = tmp_path / "rig.yaml"
    rig.write_text("stone_calibration: 1\n")
    brought.calibrate(rig)
    with_recording(brought)
    return brought


def test_what_is_missing_is_said_in_the_order_in_which_it_is_given(platform: Platform, tmp_path: Path) -> None:
    brought = bring(platform)
    with refused_as("no_calibration"):
        brought.process()
    (tmp_path / "rig.yaml").write_text("stone_calibration: 1\n")
    brought.calibrate(tmp_path / "rig.yaml")
    with refused_as("no_recording"):
        brought.process()
    with_recording(brought, "refused")
    with refused_as("no_recording", match="1 could not be registered"):
        brought.process()
    with_recording(brought, "received")
    with platform.database.transaction() as session:
        job = register(session, brought.recording(1))
    with pytest.raises(RecordingPendingError, match="1 recordings"):
        brought.process()
    with platform.database.transaction() as session:
        cancel(session, job.id, "")
    with refused_as("no_recording", match="2 could not be registered"):
        brought.process()


def ended(brought: Brought, root_id: str, state: str = "succeeded", **columns: Any) -> None:
    """The run ends so; with labels where it succeeds."""
    with brought.platform.database.transaction() as session:
        run = cancel(session, root_id, "")
        run.state = state
        if state == "succeeded":
            facts = {"parameters": {}, "code_version": "0", "frames": 1, **columns}
            recipe = run.arguments["recipe"]
            session.add(LabelSet(sequence_id=brought.sequence_id, job_id=root_id, recipe=recipe, **facts))


def recipe_of_run(brought: Brought, **request: Any) -> str:
    """The recipe of a run that is cancelled at once."""
    root_id = brought.process(**request)
    with brought.platform.database.transaction() as session:
        cancel(session, root_id, "")
    return str(brought.job(root_id).arguments["recipe"])


def test_all_registered_recordings_are_processed_and_named_in_the_arguments(ready: Brought) -> None:
    with_recording(ready, name="cameras.mcap", sha256="cd" * 32)
    with_recording(ready, "refused", name="bad.mcap", sha256="ef" * 32)
    arguments = ready.job(ready.process()).arguments
    assert arguments["recording_ids"] == ready.recording_ids[:2]
    assert arguments["recording_sha256s"] == ["ab" * 32, "cd" * 32]


def test_a_recipe_goes_by_the_content_of_recordings_whatever_their_order(ready: Brought, tmp_path: Path) -> None:
    with_recording(ready, name="cameras.mcap", sha256="cd" * 32)
    other = bring(ready.platform, "other")
    other.calibrate(tmp_path / "rig.yaml")
    with ready.platform.database.transaction() as session:  # recipes name the sequence
        session.get_one(SequenceRow, other.sequence_id).name = ready.sequence().name
    with_recording(other, name="cameras.mcap", sha256="cd" * 32)
    with_recording(other)
    assert recipe_of_run(ready) == recipe_of_run(other)
    both = recipe_of_run(ready)
    offset = {"cameras.mcap": 80_000_000}
    recipes = {both, recipe_of_run(ready, clock_offsets_ns=offset)}
    recipes |= {recipe_of_run(ready, recording_ids=(one,)) for one in ready.recording_ids}
    assert len(recipes) == 4
    assert recipe_of_run(ready, clock_offsets_ns={ready.recording_ids[1]: 80_000_000}) in recipes


def test_a_sequence_of_one_recording_keeps_the_recipe_that_earlier_versions_gave_it(ready: Brought) -> None:
    arguments = ready.job(ready.process(profile="paper")).arguments
    as_before = {
        "sequence": ready.sequence().name,
        "recordings": [["run.mcap", "ab" * 32]],
        "calibration": ["rig.yaml", _calibration_sha256(ready)],
        "odometry_topic": None,
        "lidar_topic": None,
        "profile": "paper",
        "parameters": {},
        "stages": ("synchronise", "label"),
    }
    assert arguments["recipe"] == recipe_of("labels", as_before)


def _calibration_sha256(brought: Brought) -> str:
    with brought.platform.database.reading() as session:
        return session.get_one(CalibrationRow, brought.sequence().calibration_id).sha256


def test_a_recording_that_was_sent_twice_is_one(ready: Brought) -> None:
    alone = recipe_of_run(ready)
    with_recording(ready)
    with_recording(ready, name="copy.mcap")
    assert recipe_of_run(ready) == alone


def test_what_stays_ambiguous_is_refused_by_its_own_code(ready: Brought) -> None:
    with_recording(ready, name="RUN.mcap", sha256="cd" * 32)
    with refused_as("recordings_named_alike"):
        ready.process()
    with refused_as("unknown_recording"):
        ready.process(recording_ids=("f" * 32,))
    first = (ready.recording_ids[0],)
    with refused_as("bad_clock_offset"):
        ready.process(recording_ids=first, clock_offsets_ns={"run.mcap": 1})
    with_recording(ready, name="cameras.mcap", sha256="ef" * 32)
    two = (ready.recording_ids[0], ready.recording_ids[2])
    with refused_as("bad_clock_offset"):
        ready.process(recording_ids=two, clock_offsets_ns={"other.mcap": 1})
    with refused_as("bad_clock_offset"):
        ready.process(recording_ids=two, clock_offsets_ns={"cameras.mcap": 1, two[1]: 2})
    assert ready.process(recording_ids=two)


def test_no_recording_of_a_run_is_removed_while_it_is_read(ready: Brought) -> None:
    with_recording(ready, name="cameras.mcap", sha256="cd" * 32)
    with_recording(ready, name="radar.mcap", sha256="ef" * 32)
    ready.process(recording_ids=tuple(ready.recording_ids[:2]))
    for number in (0, 1):
        with refused_as("recording_in_use"), ready.platform.database.transaction() as session:
            remove_recording(session, session.get_one(Recording, ready.recording_ids[number]))
    with ready.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, ready.recording_ids[2]))


def test_a_run_that_an_earlier_version_began_names_its_one_recording(ready: Brought) -> None:
    root_id = ready.process()
    with ready.platform.database.transaction() as session:
        run = session.get_one(Job, root_id)
        earlier = {"recording_ids", "recording_sha256s", "names_recordings", "clock_offsets_ns"}
        kept = {name: value for name, value in run.arguments.items() if name not in earlier}
        run.arguments = {**kept, "recording_id": ready.recording_ids[0]}
    arguments = ready.job(root_id).arguments
    assert recording_ids_of(arguments) == (ready.recording_ids[0],)
    assert request_of(arguments) == ProcessRequest()
    with refused_as("recording_in_use"), ready.platform.database.transaction() as session:
        remove_recording(session, session.get_one(Recording, ready.recording_ids[0]))


def test_choices_out_of_bounds_and_stages_that_do_not_begin_at_the_first_are_refused(platform: Platform) -> None:
    brought = bring(platform)
    for parameters in (
        {"surface.width_m": 0.001},
        {"reference.alpha": 0.9},
        {"reference.alpha": float("nan")},
        {"reference.alpha": True},
        {"reference.alpha": "0.05"},
        {"terrain.neighbours": 20.5},
    ):
        with refused_as("bad_parameter"):
            brought.process(parameters=parameters)
    with refused_as("bad_parameter"):
        brought.process(profile="mine")
    for stages in ((), ("label",), ("synchronise", "labels"), ("label", "synchronise")):
        with refused_as("bad_stages"):
            brought.process(stages=stages)


def test_equal_requests_are_one_run_and_another_is_told_its_id(ready: Brought) -> None:
    root_id = ready.process(parameters={"reference.alpha": 0.1, "surface.min_frames": 2})
    assert ready.process(parameters={"surface.min_frames": 2, "reference.alpha": 0.1}) == root_id
    with pytest.raises(AlreadyProcessingError) as refused:
        ready.process()
    assert refused.value.job_id == root_id
    with ready.platform.database.transaction() as session:
        cancel(session, root_id, "")
    assert ready.process() != root_id


def test_requests_at_once_give_one_run(platform_on: Platform, tmp_path: Path) -> None:
    ready = ready_on(platform_on, tmp_path)
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
    ended(ready, root_id)
    assert ready.process() == ready.process(profile=DEFAULT_PROFILE) == root_id
    assert ready.process(profile="local") != root_id


def test_of_several_label_sets_the_one_asked_for_last_counts(ready: Brought) -> None:
    for alpha in (0.1, 0.2):
        ended(ready, ready.process(parameters={"reference.alpha": alpha}), parameters={"alpha": alpha})
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


def test_deleting_and_starting_at_once_leave_no_run_alive(platform_on: Platform, tmp_path: Path) -> None:
    ready = ready_on(platform_on, tmp_path)

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
