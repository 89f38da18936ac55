"""A disk that is really full: a small tmpfs in the place of the uploads folder, where this user may mount one."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import httpx
import pytest

from services.runtime.platform import Platform
from testing.api.serving import Person, client_of
from testing.api.tus import PIECE, UPLOADS, checksum, created, metadata, offset_of, patch, sha256_of, shown
from tests.services.runtime.uploads.conftest import with_place

DISK_BYTES = 8 << 20
CONTENT = os.urandom(6 << 20)


@pytest.fixture
def disk(platform: Platform) -> Iterator[Path]:
    """The uploads folder, on a disk of 8 MiB of its own."""
    folder = platform.settings.uploads_folder
    folder.mkdir(parents=True)
    command = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "stone-test", str(folder)]
    try:
        mounted = subprocess.run(command, capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("there is no mount command")
    if mounted.returncode:
        pytest.skip(f"a tmpfs cannot be mounted by this user: {mounted.stderr.strip()}")
    with ExitStack() as stack:
        stack.callback(subprocess.run, ["umount", "--lazy", str(folder)], check=True)
        yield folder


def take_space(disk: Path) -> None:
    """Somebody else writes 4 MiB."""
    (disk / "of-somebody-else").write_bytes(b"\1" * (4 << 20))


def free_space(disk: Path) -> None:
    (disk / "of-somebody-else").unlink()


def refuses_for_want_of_room(reply: httpx.Response) -> bool:
    return (reply.status_code, reply.json()["code"]) == (507, "disk_full")


def test_a_full_disk_is_said_and_what_fitted_counts_once_space_is_freed(
    disk: Path, platform: Platform, curator: Person
) -> None:
    with client_of(platform) as api:
        where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
        take_space(disk)
        assert refuses_for_want_of_room(patch(api, curator, where, 0, CONTENT))
        offset = offset_of(api, curator, where)
        assert 1 << 20 <= offset < len(CONTENT)
        assert (disk / where.rpartition("/")[2]).read_bytes() == CONTENT[:offset]
        assert refuses_for_want_of_room(patch(api, curator, where, offset, CONTENT[offset:]))
        free_space(disk)
        assert patch(api, curator, where, offset_of(api, curator, where), CONTENT[offset:]).status_code == 204
        assert shown(api, curator, where)["sha256"] == sha256_of(CONTENT)
    assert (disk / where.rpartition("/")[2]).read_bytes() == CONTENT


def test_bytes_under_a_checksum_that_did_not_all_fit_do_not_count(
    disk: Path, platform: Platform, curator: Person
) -> None:
    with client_of(platform) as api:
        where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
        take_space(disk)
        right = checksum(CONTENT, "sha256")
        assert refuses_for_want_of_room(patch(api, curator, where, 0, CONTENT, Upload_Checksum=right))
        assert offset_of(api, curator, where) == 0
        free_space(disk)
        assert patch(api, curator, where, 0, CONTENT, Upload_Checksum=right).status_code == 204
        assert shown(api, curator, where)["state"] == "complete"


def test_a_creation_of_more_than_fits_is_refused_before_a_byte_comes(
    disk: Path, platform: Platform, curator: Person
) -> None:
    take_space(disk)
    said = metadata(filename="a", purpose="recording")
    headers = {**PIECE, **curator.headers, "Upload-Length": str(len(CONTENT)), "Upload-Metadata": said}
    with client_of(platform) as api:
        reply = api.post(UPLOADS, content=CONTENT, headers=headers)
        assert (reply.status_code, reply.json()["code"]) == (507, "storage_full")
        assert (
            f"cannot write {len(CONTENT)} bytes: the platform's disk has {4 << 20} bytes free" in reply.json()["detail"]
        )
        assert [path.name for path in disk.iterdir()] == ["of-somebody-else"]
        free_space(disk)
        assert api.post(UPLOADS, content=CONTENT, headers=headers).status_code == 201


def test_an_upload_stops_at_the_reserve_and_goes_on_once_there_is_room(
    disk: Path, platform: Platform, curator: Person
) -> None:
    store = replace(platform.settings.store, reserve_bytes=3 << 20)
    kept = replace(platform, settings=platform.settings.model_copy(update={"store": store}))
    part = CONTENT[: 4 << 20]
    with client_of(kept) as api:
        where = created(api, curator, len(part), sha256=sha256_of(part))
        (disk / "of-somebody-else").write_bytes(b"\1" * (2 << 20))
        reply = patch(api, curator, where, 0, part)
        assert refuses_for_want_of_room(reply)
        assert f"a reserve of {3 << 20} bytes" in reply.json()["detail"]
        assert os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize >= 3 << 20
        free_space(disk)
        offset = offset_of(api, curator, where)
        assert patch(api, curator, where, offset, part[offset:]).status_code == 204
        assert shown(api, curator, where)["sha256"] == sha256_of(part)


def test_what_fitted_before_it_could_be_stored_goes_to_the_store(
    disk: Path, platform: Platform, curator: Person
) -> None:
    with client_of(with_place(platform, "store", DISK_BYTES)) as api:
        where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
        take_space(disk)
        assert refuses_for_want_of_room(patch(api, curator, where, 0, CONTENT))
        offset = offset_of(api, curator, where)
        assert 1 << 20 <= offset < len(CONTENT)
        assert [path.name for path in disk.iterdir()] == ["of-somebody-else"]
        assert patch(api, curator, where, offset, CONTENT[offset:]).status_code == 204
        assert shown(api, curator, where)["sha256"] == sha256_of(CONTENT)
