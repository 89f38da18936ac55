"""A platform is wiped and comes back as it was, from either database and store onto either."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import MetaData

from services.runtime.backup.capture import make_backup
from services.runtime.backup.errors import DamagedBackupError
from services.runtime.backup.folder import BackupFolder
from services.runtime.backup.restore import restore
from services.runtime.backup.retention import prune, verify
from services.runtime.backup.snapshot import BackupSnapshot, write_files, write_snapshot
from services.runtime.backup.tables import dump
from services.runtime.database.migrate import current_revision, head_revision, schema_connection, upgrade
from services.runtime.orm import Job
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, Settings, UploadSettings
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings, opened
from testing.servers.postgres import PostgresServer
from tests.services.runtime.backup.laid import (
    HALF_SENT,
    Laid,
    add_blob,
    lay,
    objects_of,
    rows_of,
    upload_path,
    uploads_of,
)
from tests.services.runtime.database.test_next_revision import (
    Rows,
    add_revision,
    filled,
    in_order,
    rows_in,
    tables_of,
)
from tests.services.runtime.uploads.sending import made, send, sha256_of

Emptied = Callable[[str, str], Platform]


@pytest.fixture
def folder(tmp_path: Path) -> BackupFolder:
    return BackupFolder(tmp_path / "backups")


@pytest.fixture
def empty(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Emptied]:
    """Platforms on which nothing is, by kind of database and store."""
    platforms: list[Platform] = []
    servers = []

    def make(database: str = "sqlite", store: str = "folder") -> Platform:
        groups: dict[str, Any] = {}
        if database == "postgres":
            server: PostgresServer = request.getfixturevalue("postgres_server")
            servers.append(server.fresh_database())
            groups["database"] = DatabaseSettings(servers[-1].__enter__())
        if store == "s3":
            groups["store"] = request.getfixturevalue("s3_settings")
        platforms.append(opened(make_settings(tmp_path / f"target-{len(platforms)}", **groups), []))
        return platforms[-1]

    yield make
    for platform in platforms:
        platform.database.close()
    for server_context in servers:
        server_context.__exit__(None, None, None)


@pytest.fixture
def laid(platform: Platform, tmp_path: Path) -> Laid:
    return lay(platform, tmp_path / "scratch")


def test_a_backup_that_does_not_fit_is_refused_before_a_blob_is_copied(
    platform: Platform, folder: BackupFolder, tmp_path: Path
) -> None:
    lay(platform, tmp_path / "scratch")
    store = replace(platform.settings.store, reserve_bytes=2**62)
    full = replace(platform, settings=platform.settings.model_copy(update={"store": store}))
    with refused_as("storage_full"):
        make_backup(full, folder)
    assert (folder.snapshots(), list(folder.contents())) == ([], [])
    make_backup(platform, folder)
    assert folder.snapshots()


def test_a_wiped_platform_comes_back_row_for_row_and_byte_for_byte_on_the_other_database(
    platform_on: Platform, folder: BackupFolder, empty: Emptied, tmp_path: Path
) -> None:
    laid = lay(platform_on, tmp_path / "scratch")
    make_backup(platform_on, folder)
    before = rows_of(platform_on), objects_of(platform_on), uploads_of(platform_on)
    target = empty("postgres", "s3") if platform_on.database.is_sqlite else empty("sqlite", "folder")
    restored = restore(target, folder)
    rows = rows_of(target)
    assert restored.queued_again == 1
    assert objects_of(target) == before[1]
    assert uploads_of(target) == before[2] == uploads_of(target) | {laid.open_upload_id: HALF_SENT}
    jobs = {"jobs", "job_attempts"}
    assert {name: rows[name] for name in rows.keys() - jobs} == {name: before[0][name] for name in rows.keys() - jobs}
    with target.database.reading() as session:
        job, run = session.get_one(Job, laid.job_id), session.get_one(Job, laid.run_id)
    assert (job.state, job.attempts_left, run.state) == ("queued", 1, "running")


def test_bytes_under_way_that_lie_in_the_store_come_back(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied
) -> None:
    in_store = Settings(**{**dict(platform.settings), "uploads": UploadSettings(backend="store")})
    elsewhere = Platform(in_store, platform.database, platform.store)
    half = made(elsewhere, laid.owner, HALF_SENT * 2 + b"!")
    send(elsewhere, half, 0, HALF_SENT)
    taken = make_backup(platform, folder)
    assert taken.snapshot.flaws == ()
    target = empty("sqlite", "folder")
    restore(target, folder)
    assert objects_of(target) == objects_of(platform)
    whole = send(target, half, len(HALF_SENT), HALF_SENT + b"!")
    assert (whole.state, whole.sha256) == ("complete", sha256_of(HALF_SENT * 2 + b"!"))


def test_the_next_backup_brings_only_what_is_new(
    platform: Platform, laid: Laid, folder: BackupFolder, tmp_path: Path
) -> None:
    first = make_backup(platform, folder)
    add_blob(platform, laid.owner, tmp_path / "scratch", b"one more")
    contents = set(folder.contents())
    second = make_backup(platform, folder)
    assert (second.blobs, len(set(folder.contents()) - contents)) == (first.blobs + 1, 1)
    assert folder.snapshots() == [first.folder.name, second.folder.name]


def test_a_migrated_database_is_not_restored_onto(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied
) -> None:
    make_backup(platform, folder)
    target = empty("sqlite", "folder")
    upgrade(target.settings)
    with refused_as("target_not_empty"):
        restore(target, folder)
    assert objects_of(target) == {}


def test_a_backup_of_the_release_before_is_restored_to_the_next_revision(
    folder: BackupFolder, empty: Emptied, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    laid = backup_of_revision(head_revision(), make_settings(tmp_path / "previous"), folder)
    add_revision(monkeypatch, tmp_path)
    target = empty("sqlite", "folder")
    restored = restore(target, folder)
    assert restored.rows == sum(map(len, laid.values()))
    with target.database.engine.connect() as connection:
        assert current_revision(connection) == head_revision()
        tables = tables_of(connection)
        for name in ("process_counters", "upload_parts", "uploads", "scores"):
            assert rows_in(connection, tables[name], laid[name][0]) == in_order(laid[name])
        assert rows_in(connection, tables["gc_holds"], ["id"]) == []  # who held is gone


def test_a_backup_from_before_the_first_release_is_refused(
    folder: BackupFolder, empty: Emptied, tmp_path: Path
) -> None:
    backup_of_revision("0029", make_settings(tmp_path / "previous"), folder)
    with refused_as("schema_older"):
        restore(empty("sqlite", "folder"), folder)


def backup_of_revision(revision: str, settings: Settings, folder: BackupFolder) -> Rows:
    """A snapshot of every table as a release wrote it; of the objects that its rows name it had none."""
    laid, metadata = filled(settings), MetaData()
    with folder.writing(), folder.new_snapshot() as place, schema_connection(settings) as connection:
        metadata.reflect(connection, only=lambda name, _: name != "alembic_version")
        tables = dump(connection, place, metadata)
        flaws = ("no object is there",)
        write_snapshot(place, BackupSnapshot(revision, "0.1.0", 1, tables, write_files(place, ()), flaws))
    return laid


def test_foreign_objects_and_uploads_are_not_restored_beside(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied, tmp_path: Path
) -> None:
    make_backup(platform, folder)
    target = empty("sqlite", "folder")
    target.store.write("blobs/aa/other", next((tmp_path / "scratch").iterdir()))
    with refused_as("target_not_empty", match="blobs/aa/other"):
        restore(target, folder)
    target.store.delete("blobs/aa/other")
    target.settings.uploads_folder.mkdir(parents=True)
    (target.settings.uploads_folder / "f").write_bytes(b"")
    with refused_as("target_not_empty"):
        restore(target, folder)


def test_an_interrupted_restoring_goes_on(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied, tmp_path: Path
) -> None:
    add_blob(platform, laid.owner, tmp_path / "scratch", b"one more")
    make_backup(platform, folder)
    target = empty("sqlite", "folder")
    hidden = folder.path_of(laid.blob_sha256)
    aside = hidden.rename(hidden.with_name("aside"))
    with pytest.raises(DamagedBackupError):
        restore(target, folder)
    aside.rename(hidden)
    restore(target, folder)
    assert objects_of(target) == objects_of(platform)


def test_a_changed_content_is_found_and_not_restored(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied
) -> None:
    make_backup(platform, folder)
    assert verify(folder).damaged == ()
    path = folder.path_of(laid.blob_sha256)
    path.write_bytes(b"x" * path.stat().st_size)
    assert [laid.blob_sha256 in sentence for sentence in verify(folder).damaged] == [True]
    with pytest.raises(DamagedBackupError):
        restore(empty("sqlite", "folder"), folder)


@pytest.mark.parametrize("name", ["snapshot.json", "files.json", "tables/users.zst"])
def test_a_changed_snapshot_is_found_and_not_restored(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied, name: str
) -> None:
    path = make_backup(platform, folder).folder / name
    path.write_bytes(path.read_bytes()[:-7])
    assert len(verify(folder).damaged) == 1
    target = empty("sqlite", "folder")
    with pytest.raises(DamagedBackupError):
        restore(target, folder)
    assert objects_of(target) == {}


def test_what_the_platform_had_lost_is_said_and_the_rest_is_restored(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied, tmp_path: Path
) -> None:
    row = add_blob(platform, laid.owner, tmp_path / "scratch", b"will be lost")
    key = next(key for key in objects_of(platform) if row.blob_sha256 in key)
    platform.store.delete(key)
    taken = make_backup(platform, folder)
    assert [key in flaw for flaw in taken.snapshot.flaws] == [True]
    assert verify(folder).damaged == ()
    target = empty("sqlite", "folder")
    restored = restore(target, folder)
    assert restored.flawed == 1
    assert objects_of(target) == objects_of(platform)


def test_pruning_leaves_the_newest_snapshots_whole(
    platform: Platform, laid: Laid, folder: BackupFolder, empty: Emptied, tmp_path: Path
) -> None:
    make_backup(platform, folder)
    upload_path(platform, laid.open_upload_id).write_bytes(HALF_SENT + b" and more")
    newest = make_backup(platform, folder)
    pruned = prune(folder, 1)
    assert (pruned.snapshots, pruned.contents) == (1, 1)
    assert folder.snapshots() == [newest.folder.name]
    assert verify(folder).damaged == ()
    restore(empty("sqlite", "folder"), folder)


def test_one_backup_at_a_time_is_taken_into_a_folder(platform: Platform, laid: Laid, folder: BackupFolder) -> None:
    with folder.writing(), refused_as("backup_busy"):
        make_backup(platform, folder)


def test_a_backup_that_breaks_off_leaves_no_snapshot(
    platform: Platform, laid: Laid, folder: BackupFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(platform.store, "read", lambda *_: iter(lambda: 1 / 0, None))
    with pytest.raises(ZeroDivisionError):
        make_backup(platform, folder)
    assert folder.snapshots() == []
    with refused_as("snapshot_missing"):
        folder.snapshot()
