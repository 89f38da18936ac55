"""A dataset that stays where it lies is imported as an uploaded one is; only its labels and tables are copied.

Catches alone an import that reads or keeps more of an archive than it needs, or goes on with one that has changed.
"""

import io
import os
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sqlalchemy import select

from services.domain.exports.requests import start_export
from services.domain.imports.kept_files import kept_file, kept_files
from services.domain.imports.requests import INDEX, SCENE, delete_import
from services.runtime.access.storage_quota import balance
from services.runtime.database.migrate import upgrade
from services.runtime.in_place.datasets import found_dataset, requested_dataset
from services.runtime.jobs.specs import Attempt, Handler, Outcome
from services.runtime.orm import DatasetImport, Job, JobLine, LabelSet, SequenceRow
from services.runtime.platform import Platform
from stone_recordings.sync.stored_recording import RecordingPlace
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings, opened
from testing.servers.s3 import S3Server
from testing.worlds.brought_datasets import FIELD, BroughtDataset, an_owner, bring_dataset, files_of, place_dataset
from testing.worlds.drives import exported_files
from testing.worlds.placed import bucket_client, bucket_of, in_folder, on_bucket, put
from testing.worlds.published_datasets import write_published_tar
from testing.worlds.released_datasets import ReleasedDataset, write_released_zip
from testing.worlds.runs import run_all

WHAT = ReleasedDataset(scenes=2, frames=3)
ZIP = "STONE.zip"
NAMED_BY_INPUTS = ("report.json", "sequence.npz", "frames.parquet")  # the hash of the archive stands in them


@dataclass(frozen=True)
class Uploaded:
    """The twin's ZIP, and what an uploaded import of it left."""

    path: Path
    files: dict[str, bytes]
    exported: dict[str, bytes]


@pytest.fixture(scope="module")
def uploaded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Uploaded]:
    path = write_released_zip(tmp_path_factory.mktemp("published") / ZIP, WHAT)
    platform = opened(make_settings(tmp_path_factory.mktemp("uploaded")), [])
    upgrade(platform.settings)
    brought = bring_dataset(platform, path, an_owner(platform))
    run_all(platform)
    assert brought.run().state == "succeeded", brought.run().failure
    yield Uploaded(path, files_of(platform, brought.owner_id), exported(brought))
    platform.database.close()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    folder = tmp_path / "nas"
    folder.mkdir()
    return folder


def placed(platform: Platform, server: S3Server, kind: str, path: Path, root: Path) -> BroughtDataset:
    """The import of the ZIP at `released/STONE.zip` of a root of this kind, begun."""
    if kind == "bucket":
        on = on_bucket(platform, server)
        put(on, path, f"2026/released/{ZIP}")
        return place_dataset(on, RecordingPlace("field", f"released/{ZIP}"), an_owner(on))
    on = in_folder(platform, root)
    (root / "released").mkdir()
    shutil.copy(path, root / "released")
    return place_dataset(on, RecordingPlace("nas", f"released/{ZIP}"), an_owner(on))


def exported(brought: BroughtDataset) -> dict[str, bytes]:
    """The files of an export of its first sequence in the release's layout."""
    export_id, job = export_begun(brought)
    assert job.state == "succeeded", job.failure
    return exported_files(brought.platform, export_id)


def export_begun(brought: BroughtDataset, form: str = "nuscenes") -> tuple[str, Job]:
    with brought.platform.database.transaction() as session:
        sequence = session.scalars(select(SequenceRow).order_by(SequenceRow.name).limit(1)).one()
        export, job = start_export(session, sequence, form)
        export_id, job_id = export.id, job.id
    run_all(brought.platform)
    with brought.platform.database.reading() as session:
        return export_id, session.get_one(Job, job_id)


def frames_of(content: bytes) -> pa.Table:
    """The table of frames without what is said of its inputs."""
    return pq.read_table(io.BytesIO(content)).replace_schema_metadata(None)


def read_bytes(platform: Platform) -> int:
    with platform.database.reading() as session:
        lines = session.scalars(select(JobLine).where(JobLine.event == "fetched"))
        return sum(line.facts["read_bytes"] for line in lines)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["folder", "bucket"])
def test_an_archive_in_place_becomes_what_an_uploaded_one_does(
    platform: Platform, s3_server: S3Server, uploaded: Uploaded, root: Path, kind: str
) -> None:
    brought = placed(platform, s3_server, kind, uploaded.path, root)
    platform = brought.platform
    run_all(platform)
    assert brought.run().state == "succeeded", brought.run().failure
    files = files_of(platform, brought.owner_id)
    compared = [name for name in uploaded.files if "/source/" not in name and not name.endswith(NAMED_BY_INPUTS)]
    assert {name: files[name] for name in compared} == {name: uploaded.files[name] for name in compared}
    assert sum(name.endswith("labels.npz") for name in compared) == WHAT.scenes * WHAT.frames
    for name in (one for one in files if one.endswith("frames.parquet")):
        assert frames_of(files[name]).equals(frames_of(uploaded.files[name]))
    row, size_bytes = brought.row(), uploaded.path.stat().st_size
    assert (row.size_bytes, row.blob_sha256, row.upload_id, row.finished_ns is None) == (size_bytes, None, None, False)
    with platform.database.reading() as session:
        assert {one.source_place["path"] for one in session.scalars(select(LabelSet)) if one.source_place} == {
            f"released/{ZIP}"
        }
        counted = balance(session, brought.owner_id)
    kept = {name: len(content) for name, content in files.items() if "/source/" in name or name.endswith("labels.npz")}
    with zipfile.ZipFile(uploaded.path) as archive:
        extra_bytes = sum(one.file_size for one in archive.infolist() if one.filename.endswith(".pkl"))
    assert counted == sum(kept.values()) + extra_bytes
    assert exported(brought) == uploaded.exported
    if kind == "bucket":
        assert 0 < read_bytes(platform) < 3 * size_bytes


@pytest.mark.whole
def test_what_is_stored_of_an_archive_in_place_has_no_file_of_a_sensor(
    platform: Platform, uploaded: Uploaded, root: Path, s3_server: S3Server
) -> None:
    brought = placed(platform, s3_server, "folder", uploaded.path, root)
    run_all(brought.platform)
    files = files_of(brought.platform, brought.owner_id)
    with zipfile.ZipFile(uploaded.path) as archive:
        samples = [archive.read(name) for name in archive.namelist() if "/samples/" in name]
        sweep_bytes = sum(map(len, samples))
    packs = [content for name, content in files.items() if name.endswith(".pack")]
    assert not any(sample in pack for sample in samples for pack in packs)
    assert sum(map(len, packs)) < sweep_bytes / 10


@pytest.mark.whole
def test_a_tar_in_place_is_imported(platform: Platform, root: Path) -> None:
    tar, on = write_published_tar(root / "field.tar", FIELD), in_folder(platform, root)
    brought = place_dataset(on, RecordingPlace("nas", tar.name), an_owner(on), name="theirs")
    run_all(on)
    assert (brought.run().state, brought.row().name) == ("succeeded", "theirs"), brought.run().failure


def before(kind: str, act: Callable[[], None]) -> Callable[[str, Handler], Handler]:
    """Handlers of this kind do the act first."""

    def wrapped(name: str, handler: Handler) -> Handler:
        def handled(attempt: Attempt) -> Outcome:
            act()
            return handler(attempt)

        return handled if name == kind else handler

    return wrapped


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["folder", "bucket"])
@pytest.mark.parametrize("stage", [INDEX, SCENE])
@pytest.mark.parametrize("fate", ["changed", "vanished"])
def test_an_archive_that_changes_or_goes_in_between_is_named(
    platform: Platform,
    s3_server: S3Server,
    uploaded: Uploaded,
    root: Path,
    kind: str,
    stage: str,
    fate: Literal["changed", "vanished"],
) -> None:
    brought = placed(platform, s3_server, kind, uploaded.path, root)
    on = brought.platform

    def act() -> None:
        at, key = root / "released" / ZIP, f"2026/released/{ZIP}"
        if kind == "bucket" and fate == "vanished":
            bucket_client(on).delete_object(Bucket=bucket_of(on), Key=key)
        elif kind == "bucket":
            bucket_client(on).put_object(Bucket=bucket_of(on), Key=key, Body=uploaded.path.read_bytes() + b"\0")
        elif fate == "vanished":
            at.unlink(missing_ok=True)
        else:
            os.utime(at, ns=(0, at.stat().st_mtime_ns + 1))

    run_all(on, wrap=before(stage, act))
    run = brought.run()
    codes = {"changed": "recording_changed_in_place", "vanished": "recording_vanished"}
    assert (run.state, run.failure_code) == ("failed", codes[fate])
    assert f"{ZIP}" in (run.failure or "")
    assert files_of(on, brought.owner_id) == {}


@pytest.mark.whole
def test_labels_of_an_archive_that_went_stay_and_an_export_names_it(
    platform: Platform, uploaded: Uploaded, root: Path, s3_server: S3Server
) -> None:
    brought = placed(platform, s3_server, "folder", uploaded.path, root)
    run_all(brought.platform)
    with brought.platform.database.transaction() as session:
        delete_import(session, session.get_one(DatasetImport, brought.import_id))
    assert exported(brought) == uploaded.exported
    (root / "released" / ZIP).rename(root / "elsewhere.zip")
    labels = {name: content for name, content in uploaded.files.items() if name.endswith("labels.npz")}
    assert labels.items() <= files_of(brought.platform, brought.owner_id).items()
    assert export_begun(brought, "kitti")[1].failure_code == "recording_vanished"


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("../STONE.zip", "bad_place"),
        ("/STONE.zip", "bad_place"),
        ("STONE_nus_dataset", "no_archive"),
        ("notes.txt", "no_archive"),
    ],
)
def test_a_place_that_can_be_no_archive_is_refused_when_it_is_named(
    platform: Platform, root: Path, path: str, code: str
) -> None:
    on = in_folder(platform, root)
    with refused_as(code):
        place_dataset(on, RecordingPlace("nas", path), an_owner(on))


def test_a_root_that_is_not_set_is_refused(platform: Platform, root: Path) -> None:
    for on in (platform, in_folder(platform, root)):
        with refused_as("unknown_root"):
            place_dataset(on, RecordingPlace("disk", ZIP), an_owner(on))


def test_of_a_bucket_only_a_zip_can_be_named(platform: Platform, s3_server: S3Server) -> None:
    with refused_as("not_by_ranges"):
        requested_dataset(on_bucket(platform, s3_server).settings.in_place, RecordingPlace("field", "field.tar"))


def test_nothing_can_be_learnt_of_what_else_the_machine_has(platform: Platform, root: Path, tmp_path: Path) -> None:
    (tmp_path / "secret.zip").write_bytes(b"PK")
    (root / "out.zip").symlink_to(tmp_path / "secret.zip")
    (root / "circle.zip").symlink_to("circle.zip")
    (root / "folder.zip").mkdir()
    os.mkfifo(root / "pipe.zip")
    settings, said = in_folder(platform, root).settings.in_place, set[str]()
    for path in ("out.zip", "circle.zip", "folder.zip", "pipe.zip", "nothing.zip"):
        with refused_as("recording_vanished") as refusal:
            found_dataset(settings, requested_dataset(settings, RecordingPlace("nas", path)))
        said.add(str(refusal.value).replace(path, "PATH"))
    assert len(said) == 1
    assert str(root) not in said.pop()


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["upload", "folder", "bucket"])
def test_files_that_no_table_names_are_kept_with_the_import(
    platform: Platform,
    s3_server: S3Server,
    tmp_path: Path,
    root: Path,
    kind: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Catches alone an import that drops them, opens them, or keeps what is too large or is a table."""
    monkeypatch.setattr("stone_datasets.extra_files.MOST_FILE_BYTES", 1000)
    path = write_released_zip(tmp_path / ZIP, ReleasedDataset(scenes=1, frames=2))
    extra = {"v1.0-trainval/boxes_2d.json": b"no JSON", "notes/read me.txt": b"", "notes/readme.txt": b"kept"}
    with zipfile.ZipFile(path, "a") as archive:
        for name, content in {**extra, "infos.pkl": b"\x80" * 1001}.items():
            archive.writestr(f"STONE_nus_dataset/{name}", content)
        archive.writestr("elsewhere.txt", b"not below the root")
        pickled = archive.read("STONE_nus_dataset/nuscenes_infos_val.pkl")
    if kind == "upload":
        brought = bring_dataset(platform, path, an_owner(platform))
    else:
        brought = placed(platform, s3_server, kind, path, root)
    run_all(brought.platform)
    assert brought.run().state == "succeeded", brought.run().failure
    wanted = {name: extra[name] for name in ("v1.0-trainval/boxes_2d.json", "notes/readme.txt")}
    wanted["nuscenes_infos_val.pkl"] = pickled
    store = brought.platform.store
    with brought.platform.database.transaction() as session:
        row = session.get_one(DatasetImport, brought.import_id)
        found = [kept_file(session, row, one.name) for one in kept_files(session, row)]
        assert {one.name: b"".join(store.read(blob.object_key)) for one, blob in found} == wanted
        assert row.left_out == {"total": 1, "files": [{"name": "infos.pkl", "size_bytes": 1001}]}
        before = balance(session, brought.owner_id)
        delete_import(session, row)
        assert before - balance(session, brought.owner_id) == sum(map(len, wanted.values()))
