"""A whole platform on a full disk, a tmpfs of 64 MiB: an administrator can still sign in and free space."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import httpx
import pytest

from services.runtime.access import users
from services.runtime.database.ballast import Ballast
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.platform import Platform
from services.runtime.settings import StoreSettings
from testing.api.serving import Person, client_of, person
from testing.api.tus import TUS, created, patch
from testing.servers.fixtures import make_settings, opened

MIB = 1 << 20
DISK_BYTES = 64 * MIB
RESERVE_BYTES = 8 * MIB
PASSWORD = "correct horse battery"
FOREIGN = "of-somebody-else"


@pytest.fixture
def full(tmp_path: Path, _sqlite_template: Path) -> Iterator[Platform]:
    """A platform whose data folder is on a disk of 64 MiB, with a ballast and the administrator `root`."""
    settings = make_settings(tmp_path, store=StoreSettings(reserve_bytes=RESERVE_BYTES))
    settings.root.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "stone-test", str(settings.root)]
    try:
        mounted = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("there is no mount command")
    if mounted.returncode:
        pytest.skip(f"a tmpfs cannot be mounted by this user: {mounted.stderr.strip()}")
    try:
        shutil.copyfile(_sqlite_template, settings.root / "stone.sqlite3")
        platform = opened(settings, [])
        assert Ballast(settings).make()
        with platform.database.transaction() as session:
            users.create_user(session, "root", "administrator", PASSWORD)
        yield platform
        platform.database.close()
    finally:
        subprocess.run(["umount", "--lazy", str(settings.root)], check=True)


def free_bytes(platform: Platform) -> int:
    facts = os.statvfs(platform.settings.root)
    return facts.f_bavail * facts.f_frsize


def take_all(platform: Platform) -> None:
    """Fill the disk to its last byte, as another program would."""
    with (platform.settings.root / FOREIGN).open("wb", buffering=0) as file:
        try:
            while file.write(b"\1" * 4096):
                pass
        except OSError:
            return


def a_job(platform: Platform, owner: Person) -> str:
    with platform.database.transaction() as session:
        return enqueue(session, JobSpec("ingest.register", {}), Context(owner.user_id)).id


def fill_by_upload(platform: Platform, api: httpx.Client, curator: Person) -> str:
    """Fill the disk by a curator's uploads until one is refused; return the first upload."""
    where = [created(api, curator, 20 * MIB) for _ in range(4)]
    piece = os.urandom(20 * MIB)
    answers = [patch(api, curator, one, 0, piece) for one in where]
    assert [reply.status_code for reply in answers].count(507) >= 1
    assert RESERVE_BYTES <= free_bytes(platform) < RESERVE_BYTES + 4 * MIB
    return where[0]


def make_room(platform: Platform, api: httpx.Client, curator: Person, upload: str, job_id: str) -> None:
    """Free space as an operator does on a full disk."""
    assert api.delete(upload, headers={**TUS, **curator.headers}).status_code == 204
    assert api.post("/api/v1/sessions", json={"name": "root", "password": PASSWORD}).status_code in (200, 201)
    api.cookies.clear()
    assert api.post(f"/api/v1/jobs/{job_id}/cancel", headers=curator.headers).status_code == 202
    administrator = person(platform, "administrator")
    change = {"is_active": False, "reason": "fills the disk"}
    shut_out = api.patch(f"/api/v1/admin/users/{curator.user_id}", json=change, headers=administrator.headers)
    assert shut_out.status_code == 200, shut_out.text
    assert api.get("/readyz").json()["parts"]["store"]["state"] == "up"


def test_uploads_that_fill_the_disk_leave_room_for_whoever_makes_room(full: Platform) -> None:
    curator = person(full, "curator")
    with client_of(full) as api:
        job_id = a_job(full, curator)
        upload = fill_by_upload(full, api, curator)
        assert Ballast(full.settings).path.exists()
        make_room(full, api, curator, upload, job_id)
        assert Ballast(full.settings).path.exists()


def test_on_a_disk_that_others_filled_the_ballast_is_given_up_and_made_again(full: Platform) -> None:
    curator, ballast = person(full, "curator"), Ballast(full.settings)
    with client_of(full) as api:
        job_id = a_job(full, curator)
        upload = created(api, curator, 4 * MIB)
        assert patch(api, curator, upload, 0, os.urandom(4 * MIB)).status_code == 204
        take_all(full)
        assert free_bytes(full) == 0
        make_room(full, api, curator, upload, job_id)
        assert not ballast.path.exists()
        assert not ballast.make()
        assert not (full.settings.root / ".ballast").exists()
        (full.settings.root / FOREIGN).unlink()
        assert ballast.make()
        assert ballast.path.stat().st_blocks * 512 >= RESERVE_BYTES


def test_without_a_ballast_the_bytes_of_an_upload_go_before_its_row(full: Platform) -> None:
    curator = person(full, "curator")
    with client_of(full) as api:
        uploads = [created(api, curator, 4 * MIB) for _ in range(2)]
        assert patch(api, curator, uploads[0], 0, os.urandom(4 * MIB)).status_code == 204
        assert patch(api, curator, uploads[1], 0, os.urandom(MIB)).status_code == 204
        Ballast(full.settings).give_up()
        take_all(full)
        with full.database.engine.connect() as connection:  # no page of the log remains to be written again
            connection.exec_driver_sql("PRAGMA wal_checkpoint(TRUNCATE)")
        take_all(full)
        for upload in uploads:
            assert api.delete(upload, headers={**TUS, **curator.headers}).status_code == 204
            assert api.get(upload, headers=curator.headers).json()["state"] == "terminated"
        assert free_bytes(full) >= 4 * MIB
