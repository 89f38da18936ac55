"""Recordings are kept or refused, sequences synchronised for workers anywhere, and nothing is lost half-way."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import func, select

from services.domain.sequences.processing import delete_sequence
from services.domain.sequences.recordings import locate
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import Blob, JobAttempt, QuotaEntry, Recording
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from services.runtime.store.named_objects import named
from services.runtime.uploads import expire, upload_file
from simulator.pipeline import calibration_path
from stone.sensors.deskew import SweepMount
from stone_recordings.report.inspection import LONGEST_TEXT, MOST_GAPS, MOST_TOPICS, inspect, inspection_record
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from stone_recordings.sync.stored_recording import StoredRecording, StoredRecordingFile
from stone_recordings.sync.sweeps import read_sweeps, sweeps_bytes
from testing.servers.fixtures import make_settings, opened
from testing.worlds.drives import drive, registered_platform
from testing.worlds.runs import Brought, bring, followed_by, lost_once, run_all


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


def attempts(brought: Brought, job_id: str) -> list[str]:
    with brought.platform.database.reading() as session:
        rows = select(JobAttempt.outcome).where(JobAttempt.job_id == job_id).order_by(JobAttempt.number)
        return list(session.scalars(rows))


@pytest.mark.whole
@pytest.mark.parametrize("at_end", [False, True])
def test_a_recording_is_registered_and_kept_with_what_was_seen_wherever_an_attempt_was_cut_off(
    platform: Platform, bag: Path, at_end: bool
) -> None:
    brought = bring(platform)
    job_id = brought.add(bag, "Feldweg 3.mcap")
    run_all(platform, wrap=lost_once(at_end=at_end))
    recording = brought.recording()
    assert attempts(brought, job_id) == ["lost", "succeeded"]
    assert (brought.job(job_id).state, recording.state) == ("succeeded", "registered")
    assert [file.blob_sha256 for file in recording.files] == [recording.sha256]
    assert recording.inspection is not None
    seen = inspect(bag)
    assert [topic["name"] for topic in recording.inspection["topics"]] == [topic.topic.name for topic in seen.topics]
    assert recording.inspection["duration_ns"] == seen.duration_ns
    assert [finding["code"] for finding in recording.findings] == [finding.code for finding in seen.findings]
    with platform.database.reading() as session:
        blob = session.get_one(Blob, recording.sha256)
    assert platform.store.local(blob.object_key).read_bytes() == bag.read_bytes()
    file = upload_file(platform.settings, recording.files[0].upload_id or "")
    assert file.exists()
    expire(platform)
    assert not file.exists()


def test_what_is_no_bag_fails_the_job_and_refuses_the_recording_in_the_same_words(
    platform: Platform, tmp_path: Path
) -> None:
    brought = bring(platform)
    (tmp_path / "page").write_text("<!doctype html><title>Sign in</title>")
    job_id = brought.add(tmp_path / "page", "run.mcap")
    upload_id = brought.recording().files[0].upload_id or ""
    run_all(platform)
    job, recording = brought.job(job_id), brought.recording()
    assert (job.state, job.failure_code, recording.state) == ("failed", "BAG-001", "refused")
    assert recording.findings == [{"code": "BAG-001", "severity": "error", "topic": "", "message": job.failure}]
    assert recording.files[0].blob_sha256 is None
    assert not upload_file(platform.settings, upload_id).exists()
    with platform.database.reading() as session:
        assert session.scalar(select(func.sum(QuotaEntry.amount))) == 0


def test_a_refusal_cut_off_before_the_job_failed_is_repeated(platform: Platform, tmp_path: Path) -> None:
    brought = bring(platform)
    (tmp_path / "run.mcap").write_bytes(b"")
    job_id = brought.add(tmp_path / "run.mcap")

    def killed_after_refusal(_kind: str, handler: Handler) -> Handler:
        def run(attempt: Attempt) -> Outcome:
            if brought.recording().state == "refused":
                return handler(attempt)
            with pytest.raises(Exception, match=r"run\.mcap"):
                handler(attempt)
            raise RuntimeError("killed")

        return run

    run_all(platform, wrap=killed_after_refusal)
    job = brought.job(job_id)
    assert (job.state, job.failure_code) == ("failed", "recording_refused")
    assert brought.recording().findings[0]["message"] in job.failure


@pytest.mark.whole
def test_bytes_that_are_not_those_received_are_refused(platform: Platform, bag: Path) -> None:
    brought = bring(platform)
    job_id = brought.add(bag)
    with platform.database.transaction() as session:
        session.get_one(Recording, brought.recording_ids[0]).files[0].sha256 = "ab" * 32
    run_all(platform)
    assert brought.job(job_id).failure_code == "recording_changed"
    assert brought.recording().state == "refused"


def test_a_worker_without_the_uploads_says_so(platform: Platform, bag: Path) -> None:
    brought = bring(platform)
    job_id = brought.add(bag)
    upload_file(platform.settings, brought.recording().files[0].upload_id or "").unlink()
    run_all(platform)
    assert brought.job(job_id).failure_code == "recording_file_missing"
    assert brought.recording().state == "received"


@pytest.mark.whole
def test_a_recording_whose_sequence_is_deleted_meanwhile_is_not_kept(platform: Platform, bag: Path) -> None:
    brought = bring(platform)
    job_id = brought.add(bag)
    deleted = followed_by(lambda session: delete_sequence(session, brought.sequence()), platform)
    run_all(platform, wrap=deleted)
    assert brought.job(job_id).state == "cancelled"
    with platform.database.reading() as session:
        assert session.scalars(select(Blob)).all() == []


def test_synchronising_leaves_the_sequence_for_workers_on_any_machine(
    platform: Platform, bag: Path, s3_settings: StoreSettings, tmp_path: Path
) -> None:
    here = replace(platform, store=opened(make_settings(tmp_path, store=s3_settings), []).store)
    brought = bring(here)
    brought.calibrate(calibration_path(bag))
    brought.add(bag)
    run_all(here)
    root_id = brought.process(stages=("synchronise",))
    run_all(here)
    run = brought.job(root_id)
    assert (run.state, run.failure) == ("succeeded", "")
    job, check = (job for job in brought.jobs(root_id) if job.queue)
    assert job.result is not None
    assert check.result is not None
    there = opened(make_settings(tmp_path / "there", store=s3_settings), [])
    left = {
        name: b"".join(there.store.read(f"work/{root_id}/{name}.npz")) for name in ("sequence", "sweeps", "checked")
    }
    sequence, sweeps = open_sequence(bag, calibration_path(bag), "field")
    assert left["checked"] == sequence_bytes(sequence)
    so_far, _ = open_sequence(bag, calibration_path(bag), "field", SynchroniseOptions(is_checked=False))
    assert left["sequence"] == sequence_bytes(so_far)
    assert (job.result["is_checked"], check.result["is_checked"]) == (False, True)
    assert [one["code"] for one in check.result["findings"]] == [one.code for one in sequence.findings]
    assert job.result["frames"] == len(sequence.frames)
    described = read_sweeps(left["sweeps"], partial(locate, there))
    assert described.path.name == "run.mcap"
    assert described.path.resolve().is_relative_to(tmp_path / "there")
    for index in range(len(sequence.frames)):
        np.testing.assert_array_equal(described.sweep(index).points_lidar, sweeps.sweep(index).points_lidar)
    there.database.close()


def test_a_sequence_is_read_as_it_was_written(bag: Path) -> None:
    sequence, _ = open_sequence(bag, calibration_path(bag), "field")
    again = read_sequence(sequence_bytes(sequence))
    assert sequence_bytes(again) == sequence_bytes(sequence)
    assert again.frames.tokens == sequence.frames.tokens
    np.testing.assert_array_equal(again.frames.map_from_ego.wxyz_xyz, sequence.frames.map_from_ego.wxyz_xyz)
    assert again.frames.associations.keys() == sequence.frames.associations.keys()
    for channel, taken in sequence.frames.associations.items():
        np.testing.assert_array_equal(again.frames.associations[channel].dt_ns, taken.dt_ns)
        np.testing.assert_array_equal(again.frames.associations[channel].message_index, taken.message_index)
    assert (again.findings, again.inputs, again.excluded) == (sequence.findings, sequence.inputs, sequence.excluded)
    assert again.calibration.footprint == sequence.calibration.footprint
    for ours, theirs in zip(again.calibration.mounts, sequence.calibration.mounts, strict=True):
        assert (ours.name, ours.kind, ours.intrinsics, ours.frame_id) == (
            theirs.name, theirs.kind, theirs.intrinsics, theirs.frame_id,
        )  # fmt: skip
        np.testing.assert_array_equal(ours.lidar_from_sensor.wxyz_xyz, theirs.lidar_from_sensor.wxyz_xyz)


def test_sweeps_without_a_motion_are_read_as_they_were_written(bag: Path) -> None:
    _, sweeps = open_sequence(bag, calibration_path(bag), "field")
    assert isinstance(sweeps.mount, SweepMount)
    kept = StoredRecording("run.mcap", (StoredRecordingFile("blobs/aa/key", "run.mcap"),))
    still = read_sweeps(sweeps_bytes(replace(sweeps, mount=None), kept), lambda _: bag)
    assert still.mount is None
    np.testing.assert_array_equal(still.sweep(2).points_lidar.shape[1], 3)


def test_a_hostile_inspection_is_kept_short(bag: Path) -> None:
    seen = inspect(bag)
    topic = seen.topics[0]
    long = replace(topic, topic=replace(topic.topic, name="/" + "x" * 10_000))
    gaps = replace(long, timing=replace(long.timing, gaps=seen.topics[0].timing.gaps * 10 or ()))
    findings = tuple(replace(f, message="y" * 10_000) for f in seen.findings) * 1000
    record = inspection_record(replace(seen, topics=(gaps,) * 5000, findings=findings))
    assert len(record["topics"]) == MOST_TOPICS
    assert record["topics_total"] == 5000
    assert record["findings_total"] == len(findings)
    assert len(record["topics"][0]["name"]) == LONGEST_TEXT
    assert all(len(topic["gaps"]) <= MOST_GAPS for topic in record["topics"])
    assert len(json.dumps(record)) < 500_000


def test_names_of_objects_that_are_gone_are_forgotten(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.write_text("1")
    second.write_text("2")
    folder = tmp_path / "names"
    assert named(folder, first, "a.mcap").read_text() == "1"
    assert named(folder, first, "a.mcap") == folder / "first" / "a.mcap"
    first.unlink()
    assert named(folder, second, "b.mcap").read_text() == "2"
    assert [path.name for path in folder.iterdir()] == ["second"]


@pytest.mark.parametrize("name", ["", ".", "..", "../b.mcap", "/etc/passwd"])
def test_a_name_never_leads_out_of_its_folder(tmp_path: Path, name: str) -> None:
    (tmp_path / "object").write_text("1")
    with pytest.raises(ValueError, match="is not a file name"):
        named(tmp_path / "names", tmp_path / "object", name)
    assert [path.name for path in tmp_path.iterdir()] == ["object"]


@pytest.mark.whole
def test_a_run_fails_by_the_refusal_of_its_stage(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path) -> None:
    with registered_platform(tmp_path_factory, tmp_path / "platform") as brought:
        root_id = brought.process(odometry_topic="/no/such/topic")
        run_all(brought.platform)
        run = brought.job(root_id)
        (job,) = (job for job in brought.jobs(root_id) if job.queue)
        assert (run.state, run.failure_code) == ("failed", job.failure_code)
        assert "/no/such/topic" in run.failure
        assert brought.process() != root_id
