"""Recordings that stay where they lie are labelled as uploaded ones are, and nothing else is read or shown."""

import mmap
import os
import shutil
import sqlite3
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest
from sqlalchemy import func, select

from services.domain.sequences.recordings import add_in_place, remove_recording
from services.runtime.database.migrate import upgrade
from services.runtime.in_place.bucket import PlacedObject
from services.runtime.in_place.folders import located_in_place
from services.runtime.in_place.places import found_place, requested_place
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.orm import JobLine, QuotaEntry, Recording
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path
from stone_recordings.bags.db3.sql import SqlRows
from stone_recordings.sync.stored_recording import RecordingPlace
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings, opened
from testing.servers.s3 import S3Server
from testing.worlds.drives import drive
from testing.worlds.placed import bucket_client, bucket_of, in_folder, on_bucket, put, stored_bytes
from testing.worlds.raw_pictures import with_raw_pictures
from testing.worlds.runs import Brought, bring, run_all

OPTIONS = SimulateOptions(seconds=2.0, seed=3, channels=32, columns=360, camera_width_px=96, world_width_m=30.0)
PICTURE_PX = (640, 480)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory, OPTIONS)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "nas"
    folder.mkdir()
    return folder


@pytest.fixture
def placed(platform: Platform, root: Path) -> Platform:
    """A platform with the root `nas`."""
    return in_folder(platform, root)


def add(brought: Brought, path: str, root: str = "nas") -> str:
    """The id of the job that reads the recording."""
    with brought.platform.database.transaction() as session:
        settings = brought.platform.settings.in_place
        recording, job = add_in_place(session, settings, brought.sequence(), RecordingPlace(root, path))
        brought.recording_ids.append(recording.id)
        return job.id


def registered(brought: Brought, path: str) -> None:
    """Have it read; it is not refused."""
    job_id = add(brought, path)
    run_all(brought.platform)
    assert brought.job(job_id).failure == ""


def labelled(brought: Brought) -> dict[str, bytes]:
    """Process it; the labels of each frame by token."""
    run = brought.process()
    run_all(brought.platform)
    assert brought.job(run).failure == ""
    return {name: content for name, content in brought.files().items() if name.endswith("labels.npz")}


def failure_of_run(brought: Brought, **request: str) -> tuple[str | None, str]:
    """Process it; code and sentence of the failure."""
    run = brought.process(**request)
    run_all(brought.platform)
    job = brought.job(run)
    return job.failure_code, job.failure or ""


def lines_of(brought: Brought, job_id: str) -> list[JobLine]:
    with brought.platform.database.reading() as session:
        return list(session.scalars(select(JobLine).where(JobLine.job_id == job_id)))


@pytest.fixture(scope="module")
def labels(tmp_path_factory: pytest.TempPathFactory, source: Path) -> dict[str, bytes]:
    """The labels of the recording with small pictures, uploaded."""
    folder = tmp_path_factory.mktemp("uploaded")
    settings = make_settings(folder)
    upgrade(settings)
    platform = opened(settings, [])
    brought = bring(platform)
    brought.calibrate(calibration_path(source))
    brought.add(with_raw_pictures(source, folder / "run.mcap", (32, 24)))
    run_all(platform)
    found = labelled(brought)
    platform.database.close()
    return found


@pytest.mark.whole
@pytest.mark.parametrize("name", ["run_0.db3", pytest.param("run/run_0.db3", marks=pytest.mark.release), "run.mcap"])
def test_a_bag_in_place_is_labelled_as_an_uploaded_one_and_not_copied(
    placed: Platform, root: Path, source: Path, labels: dict[str, bytes], name: str
) -> None:
    bag = root / name
    bag.parent.mkdir(exist_ok=True)
    with_raw_pictures(source, bag, PICTURE_PX)
    brought = bring(placed)
    brought.calibrate(calibration_path(source))
    registered(brought, name.partition("/")[0])
    recording = brought.recording()
    assert (recording.state, recording.size_bytes, recording.files) == ("registered", bag.stat().st_size, [])
    assert labelled(brought) == labels


@pytest.mark.whole
def test_a_fifth_of_a_database_in_place_is_read_at_most_and_two_pictures_of_a_camera(
    placed: Platform, root: Path, source: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag = with_raw_pictures(source, root / "run.db3", PICTURE_PX)
    with closing(sqlite3.connect(bag)) as connection:
        query = "SELECT m.id, t.type, t.name, length(m.data) FROM messages m JOIN topics t ON t.id = m.topic_id"
        rows = connection.execute(query).fetchall()
    read = mmap.mmap(-1, len(rows) + 1)  # children are forked from this process and share it
    whole, several = SqlRows.data, SqlRows.several

    def data(self: SqlRows, rowid: int) -> bytes:
        read[rowid] = 1
        return whole(self, rowid)

    def many(self: SqlRows, rowids: Sequence[int]) -> dict[int, bytes]:
        for rowid in rowids:
            read[rowid] = 1
        return several(self, rowids)

    monkeypatch.setattr(SqlRows, "data", data)
    monkeypatch.setattr(SqlRows, "several", many)
    brought = bring(placed)
    brought.calibrate(calibration_path(source))
    registered(brought, "run.db3")
    labelled(brought)
    pictures = Counter(name for rowid, kind, name, _ in rows if read[rowid] and kind == "sensor_msgs/msg/Image")
    assert len(pictures) == 6
    assert max(pictures.values()) <= 2
    assert sum(size for rowid, _, _, size in rows if read[rowid]) < bag.stat().st_size / 5


@pytest.mark.whole
def test_a_registered_bag_in_place_takes_a_tenth_of_its_size_at_most(
    placed: Platform, root: Path, source: Path
) -> None:
    brought, bag = bring(placed), with_raw_pictures(source, root / "run.mcap", PICTURE_PX)
    registered(brought, "run.mcap")
    assert 0 < stored_bytes(placed) < bag.stat().st_size / 10


@pytest.mark.whole
@pytest.mark.parametrize("part_bytes", [pytest.param(2**30, marks=pytest.mark.release), 2**19])
def test_an_object_is_labelled_as_an_uploaded_bag_by_the_ranges_that_labels_need(
    platform: Platform,
    s3_server: S3Server,
    source: Path,
    labels: dict[str, bytes],
    monkeypatch: pytest.MonkeyPatch,
    part_bytes: int,
) -> None:
    monkeypatch.setattr("services.ingest.excerpt.BATCH_BYTES", part_bytes)
    brought, bag = bring(on_bucket(platform, s3_server)), source.with_name("raw.mcap")
    if not bag.exists():
        with_raw_pictures(source, bag, PICTURE_PX)
    put(brought.platform, bag, "2026/run.mcap")
    brought.calibrate(calibration_path(source))
    job_id = add(brought, "run.mcap", "field")
    run_all(brought.platform)
    assert brought.job(job_id).failure == ""
    (fetched,) = [line.facts for line in lines_of(brought, job_id) if line.event == "fetched"]
    assert fetched["read_bytes"] < bag.stat().st_size / 5
    assert (fetched["files"] > 1) == (part_bytes < 2**20)
    recording = brought.recording()
    assert recording.size_bytes == bag.stat().st_size
    assert sum(file.size_bytes for file in recording.files) < bag.stat().st_size / 10
    assert labelled(brought) == labels
    with brought.platform.database.transaction() as session:
        assert session.scalar(select(func.sum(QuotaEntry.amount))) > 0
        remove_recording(session, session.get_one(Recording, recording.id))


@pytest.mark.whole
def test_an_object_that_changed_or_went_in_between_is_named(
    platform: Platform, s3_server: S3Server, source: Path
) -> None:
    brought = bring(on_bucket(platform, s3_server))
    put(brought.platform, source, "2026/run.mcap")
    brought.calibrate(calibration_path(source))
    add(brought, "run.mcap", "field")
    run_all(brought.platform)
    at = {"Bucket": bucket_of(brought.platform), "Key": "2026/run.mcap"}
    bucket_client(brought.platform).put_object(**at, Body=source.read_bytes() + b"\0")
    code, sentence = failure_of_run(brought)
    assert (code, "run.mcap of field:run.mcap" in sentence) == ("recording_changed_in_place", True)
    bucket_client(brought.platform).delete_object(Bucket=bucket_of(brought.platform), Key="2026/run.mcap")
    assert failure_of_run(brought)[0] == "recording_vanished"


def test_an_object_that_changes_while_it_is_read_is_named(
    platform: Platform, s3_server: S3Server, tmp_path: Path
) -> None:
    settings = on_bucket(platform, s3_server)
    for content in (b"one", b"two"):
        (tmp_path / "run").write_bytes(content)
        put(settings, tmp_path / "run", "2026/run.mcap")
        if content == b"one":
            place = found_place(settings.settings.in_place, RecordingPlace("field", "run.mcap"))
    with refused_as("recording_changed_in_place"):
        PlacedObject(settings.settings.in_place, place).fetch([(0, 3)], tmp_path / "run")


def test_of_a_bucket_only_an_mcap_below_its_prefix_can_be_named(platform: Platform, s3_server: S3Server) -> None:
    settings = on_bucket(platform, s3_server).settings.in_place
    with refused_as("not_by_ranges"):
        requested_place(settings, RecordingPlace("field", "run_0.db3"))
    with refused_as("bad_place"):
        requested_place(settings, RecordingPlace("field", "../other/run.mcap"))
    with refused_as("recording_vanished"):
        found_place(settings, RecordingPlace("field", "nothing.mcap"))


@pytest.mark.whole
def test_a_file_that_changed_in_between_is_named_and_labels_of_it_stay(
    placed: Platform, root: Path, source: Path
) -> None:
    bag = with_raw_pictures(source, root / "run.db3", (32, 24))
    brought = bring(placed)
    brought.calibrate(calibration_path(source))
    registered(brought, "run.db3")
    before = labelled(brought)
    was = bag.stat()
    os.utime(bag, ns=(was.st_atime_ns, was.st_mtime_ns + 1))
    code, sentence = failure_of_run(brought, ground="auto")
    assert (code, "run.db3 of nas:run.db3" in sentence) == ("recording_changed_in_place", True)
    with sqlite3.connect(bag) as connection:
        connection.execute("UPDATE messages SET timestamp = timestamp + 1")
    os.utime(bag, ns=(was.st_atime_ns, was.st_mtime_ns))
    assert bag.stat().st_size == was.st_size
    code, sentence = failure_of_run(brought, ground="auto")
    assert (code, "contains other messages" in sentence) == ("recording_changed_in_place", True)
    bag.rename(root / "elsewhere.db3")
    assert failure_of_run(brought, ground="auto")[0] == "recording_vanished"
    assert {name: content for name, content in brought.files().items() if name.endswith("labels.npz")} == before


@pytest.mark.parametrize("path", ["", "/run.db3", "../run.db3", "a/../run.db3", "a//run.db3", "./run.db3", "a\n.db3"])
def test_a_path_that_is_more_than_names_below_the_root_is_refused(placed: Platform, path: str) -> None:
    with refused_as("bad_place"):
        requested_place(placed.settings.in_place, RecordingPlace("nas", path))


def test_a_root_that_is_not_set_is_refused_and_its_folder_is_not_named(placed: Platform, root: Path) -> None:
    with refused_as("unknown_root", match="the roots are nas") as refusal:
        requested_place(placed.settings.in_place, RecordingPlace("disk", "run.db3"))
    assert str(root) not in str(refusal.value)


def test_nothing_can_be_learnt_of_what_else_the_machine_has(
    placed: Platform, root: Path, tmp_path: Path, source: Path
) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    shutil.copy(source, outside / "run.mcap")
    (root / "out.mcap").symlink_to(outside / "run.mcap")
    (root / "folder").symlink_to(outside)
    (root / "linked").mkdir()
    (root / "linked/run_0.mcap").symlink_to(outside / "run.mcap")
    (root / "circle.mcap").symlink_to("circle.mcap")
    (root / "notes.txt").write_text("secret")
    os.mkfifo(root / "pipe.mcap")
    said = set[str]()
    for path in ("out.mcap", "folder", "linked", "circle.mcap", "notes.txt", "pipe.mcap", "nothing.mcap"):
        with refused_as("recording_vanished") as refusal:
            found_place(
                placed.settings.in_place, requested_place(placed.settings.in_place, RecordingPlace("nas", path))
            )
        said.add(str(refusal.value).replace(path, "PATH").replace("run_0.mcap", "PATH"))
    assert len(said) == 1
    assert str(root) not in said.pop()


def test_a_link_within_the_root_is_followed(placed: Platform, root: Path, source: Path) -> None:
    shutil.copy(source, root / "run.mcap")
    (root / "latest.mcap").symlink_to("run.mcap")
    place = found_place(placed.settings.in_place, RecordingPlace("nas", "latest.mcap"))
    assert [file.name for file in place.files] == ["latest.mcap"]
    assert located_in_place(placed.settings, place).read_bytes() == source.read_bytes()


def test_what_is_no_bag_is_refused_by_the_job(placed: Platform, root: Path) -> None:
    (root / "run.mcap").write_text("<!doctype html><title>Sign in</title>")
    brought = bring(placed)
    job_id = add(brought, "run.mcap")
    run_all(placed)
    assert (brought.job(job_id).failure_code, brought.recording().state) == ("BAG-001", "refused")


def test_a_folder_that_is_not_mounted_is_waited_for(placed: Platform, root: Path) -> None:
    root.rmdir()
    brought = bring(placed)
    job_id = add(brought, "run.mcap")
    run_all(placed)
    assert (brought.job(job_id).failure_code, brought.recording().state) == ("root_unavailable", "received")


@pytest.mark.parametrize("folders", ["nas", "nas=relative", "Nas=/mnt", "=/mnt"])
def test_an_entry_that_names_no_root_is_refused_at_the_start(folders: str) -> None:
    with refused_as("impossible_settings", match="STONE_IN_PLACE__FOLDERS"):
        Settings(in_place=InPlaceSettings(folders))
