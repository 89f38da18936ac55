"""Several files that are one bag are read, kept and processed as one; what was cut off is recovered.

Catches alone a member of a split bag that is lost, kept twice or read in another order.
"""

import json
import shutil
import sqlite3
from pathlib import Path

import pytest
from sqlalchemy import func, select

from services.domain.sequences.processing import delete_sequence
from services.domain.sequences.recordings import remove_recording
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from services.runtime.orm import Blob, Preview, QuotaEntry
from services.runtime.platform import Platform
from services.runtime.uploads import expire, upload_file
from simulator.pipeline import calibration_path
from stone_recordings.bags import private_folder
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.sequence_file import sequence_bytes
from testing.worlds.drives import drive
from testing.worlds.runs import Brought, bring, run_all
from tests.stone_recordings.databases import SCHEMAS, insert
from tests.stone_recordings.splitting import split_into
from tests.stone_recordings.writing import HESAI, POINT_CLOUD, Recorded, cloud_payload, sweep

pytestmark = pytest.mark.whole

PAGES = {"quality.html", "quality.json"}
PICTURES = {"sweep.png", "track.png"}


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory)


@pytest.fixture(scope="module")
def split(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same messages in a folder of three files."""
    folder = tmp_path_factory.mktemp("split") / "run_split"
    folder.mkdir()
    split_into(bag, folder, 3)
    return folder


@pytest.fixture(scope="module")
def cut(bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first part of the bag, as a recorder leaves it that loses power."""
    path = tmp_path_factory.mktemp("cut") / "cut.mcap"
    path.write_bytes(bag.read_bytes()[: bag.stat().st_size * 3 // 4])
    return path


def blob_bytes(brought: Brought, sha256: str | None) -> bytes:
    with brought.platform.database.reading() as session:
        blob = session.get_one(Blob, sha256)
    return b"".join(brought.platform.store.read(blob.object_key))


def previews(brought: Brought, of: str | None = None) -> dict[str, Preview]:
    with brought.platform.database.reading() as session:
        return {row.name: row for row in session.scalars(select(Preview)) if of in (None, row.recording_id)}


def test_a_split_bag_is_registered_with_every_file_kept_and_given_back_when_it_is_removed(
    platform: Platform, split: Path, bag: Path
) -> None:
    brought = bring(platform)
    job_id = brought.add(split)
    run_all(platform)
    recording = brought.recording()
    assert (brought.job(job_id).failure, recording.state, recording.filename) == ("", "registered", "run_split")
    assert [file.filename for file in recording.files] == ["run_0.mcap", "run_1.mcap", "run_2.mcap"]
    for file in recording.files:
        assert blob_bytes(brought, file.blob_sha256) == (split / file.filename).read_bytes()
        assert file.recovered_blob_sha256 is None
    assert recording.size_bytes == sum(path.stat().st_size for path in split.iterdir())
    assert recording.inspection is not None
    counts = {topic["name"]: topic["count"] for topic in recording.inspection["topics"]}
    assert counts == {seen.topic.name: seen.topic.count for seen in inspect(bag).topics}
    shown = previews(brought, recording.id)
    assert set(shown) == PAGES | PICTURES
    assert json.loads(blob_bytes(brought, shown["quality.json"].blob_sha256)) == recording.quality
    expire(platform)
    assert not any(upload_file(platform.settings, file.upload_id or "").exists() for file in recording.files)
    made_bytes = sum(preview.size_bytes for preview in shown.values())
    assert taken_bytes(platform) == recording.size_bytes + made_bytes
    with platform.database.transaction() as session:
        remove_recording(session, brought.recording())
    assert (taken_bytes(platform), previews(brought)) == (0, {})


def test_a_split_bag_makes_the_sequence_of_the_whole_and_goes_with_it(
    platform: Platform, split: Path, bag: Path
) -> None:
    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    brought.add(split)
    run_all(platform)
    root_id = brought.process(stages=("synchronise",))
    run_all(platform)
    assert brought.job(root_id).failure == ""
    left = b"".join(platform.store.read(f"work/{root_id}/sequence.npz"))
    sequence, _ = open_sequence(split, calibration_path(bag), "field", SynchroniseOptions())
    assert left == sequence_bytes(sequence)
    whole, _ = open_sequence(bag, calibration_path(bag), "field", SynchroniseOptions())
    assert sequence.frames.tokens == whole.frames.tokens
    assert sequence.inputs["run_split"] == brought.recording().sha256
    with platform.database.transaction() as session:
        delete_sequence(session, brought.sequence())
    assert (taken_bytes(platform), previews(brought)) == (0, {})


def test_what_was_cut_off_is_recovered_and_the_original_kept(platform: Platform, cut: Path, bag: Path) -> None:
    brought = bring(platform)
    brought.calibrate(calibration_path(bag))
    job_id = brought.add(cut)
    run_all(platform)
    recording = brought.recording()
    (file,) = recording.files
    assert (brought.job(job_id).failure, recording.state) == ("", "registered")
    assert recording.findings[0]["code"] == "BAG-010"
    assert blob_bytes(brought, file.blob_sha256) == cut.read_bytes()
    recovered = blob_bytes(brought, file.recovered_blob_sha256)
    assert recovered.endswith(b"\x89MCAP0\r\n")
    root_id = brought.process(stages=("synchronise",))
    run_all(platform)
    job = next(job for job in brought.jobs(root_id) if job.queue)
    assert (job.state, job.failure) == ("succeeded", "")
    assert job.result is not None
    assert 0 < job.result["frames"] < 10


def test_a_cut_member_of_a_split_bag_is_recovered_alone(platform: Platform, split: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run_split"
    shutil.copytree(split, folder)
    last = folder / "run_2.mcap"
    last.write_bytes(last.read_bytes()[: last.stat().st_size * 3 // 4])
    brought = bring(platform)
    brought.add(folder)
    run_all(platform)
    files = brought.recording().files
    assert [file.recovered_blob_sha256 is not None for file in files] == [False, False, True]
    assert [finding["code"] for finding in brought.recording().findings].count("BAG-010") == 1


def test_a_refused_group_gives_every_byte_back(platform: Platform, split: Path, tmp_path: Path) -> None:
    folder = tmp_path / "run_split"
    shutil.copytree(split, folder)
    (folder / "run_1.mcap").write_text("<!doctype html><title>Sign in</title>")
    listed = "".join(f"\n    - run_{number}.mcap" for number in range(3))
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:{listed}\n")
    brought = bring(platform)
    job_id = brought.add(folder)
    upload_ids = [file.upload_id or "" for file in brought.recording().files]
    run_all(platform)
    assert (brought.recording().state, brought.job(job_id).failure_code) == ("refused", "BAG-001")
    assert not any(upload_file(platform.settings, upload_id).exists() for upload_id in upload_ids)
    assert taken_bytes(platform) == 0


def taken_bytes(platform: Platform) -> int:
    with platform.database.reading() as session:
        return int(session.scalar(select(func.coalesce(func.sum(QuotaEntry.amount), 0))) or 0)


def test_a_database_that_was_not_closed_is_read_with_its_journal_and_neither_changes(platform, tmp_path):
    folder = tmp_path / "run"
    folder.mkdir()
    unclosed_database(tmp_path / "recorder.db3", folder / "run_0.db3")
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert before["run_0.db3-wal"], "the recorder died with a journal"
    brought = bring(platform)
    job_id = brought.add(folder)
    run_all(platform)
    recording = brought.recording()
    assert (brought.job(job_id).failure, recording.state) == ("", "registered")
    assert recording.inspection is not None
    assert [(topic["name"], topic["count"]) for topic in recording.inspection["topics"]] == [("/points", 5)]
    assert "BAG-029" in [finding["code"] for finding in recording.findings]
    assert {file.filename: blob_bytes(brought, file.blob_sha256) for file in recording.files} == before


def test_a_disk_without_room_is_no_fault_of_the_recording(platform, tmp_path, monkeypatch):
    folder = tmp_path / "run"
    folder.mkdir()
    unclosed_database(tmp_path / "recorder.db3", folder / "run_0.db3")
    brought = bring(platform)
    job_id = brought.add(folder)
    with monkeypatch.context() as full:
        full.setattr(private_folder, "SPARED_BYTES", 2**62)
        run_all(platform)
    assert (brought.job(job_id).state, brought.job(job_id).failure_code) == ("failed", "BAG-028")
    assert brought.recording().state == "received"
    assert all(upload_file(platform.settings, file.upload_id or "").exists() for file in brought.recording().files)


def unclosed_database(recorder: Path, left: Path) -> None:
    """What is left on the disk of five messages when the recorder dies before it closes."""
    start_ns = 1_700_000_000_000_000_000
    clouds = [
        Recorded("/points", POINT_CLOUD, start_ns + number * 10**8, cloud_payload(sweep(HESAI, 10, seed=number)))
        for number in range(5)
    ]
    connection = sqlite3.connect(recorder, isolation_level=None)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.executescript(SCHEMAS[4])
    insert(connection, clouds)
    for suffix in ("", "-wal"):
        shutil.copyfile(f"{recorder}{suffix}", f"{left}{suffix}")
    connection.close()
