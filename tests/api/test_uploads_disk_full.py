"""A disk that is really full: a small tmpfs in the place of the uploads folder, where this user may mount one."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack
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
    """The uploads folder, on a disk of 8 MiB of its own, with 4 MiB of somebody else's in it."""
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
        (folder / "of-somebody-else").write_bytes(b"\1" * (4 << 20))
        yield folder


def free_space(disk: Path) -> None:
    (disk / "of-somebody-else").unlink()


def refuses_for_want_of_room(reply: httpx.Response) -> bool:
    return (reply.status_code, reply.json()["code"]) == (507, "disk_full")


def test_a_full_disk_is_said_and_what_fitted_counts_once_space_is_freed(
    disk: Path, platform: Platform, curator: Person
) -> None:
    with client_of(platform) as api:
        where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
        assert refuses_for_want_of_room(patch(api, curator, where, 0, CONTENT))
        offset = offset_of(api, curator, where)
        assert 3 << 20 <= offset < len(CONTENT)
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
        right = checksum(CONTENT, "sha256")
        assert refuses_for_want_of_room(patch(api, curator, where, 0, CONTENT, Upload_Checksum=right))
        assert offset_of(api, curator, where) == 0
        free_space(disk)
        assert patch(api, curator, where, 0, CONTENT, Upload_Checksum=right).status_code == 204
        assert shown(api, curator, where)["state"] == "complete"


def test_a_creation_with_more_than_fits_is_told_how_much_did(disk: Path, platform: Platform, curator: Person) -> None:
    said = metadata(filename="a", purpose="recording")
    headers = {**PIECE, **curator.headers, "Upload-Length": str(len(CONTENT)), "Upload-Metadata": said}
    with client_of(platform) as api:
        reply = api.post(UPLOADS, content=CONTENT, headers=headers)
        assert reply.status_code == 201
        offset, where = int(reply.headers["Upload-Offset"]), reply.headers["Location"]
        assert 3 << 20 <= offset < len(CONTENT)
        free_space(disk)
        assert patch(api, curator, where, offset, CONTENT[offset:]).status_code == 204
        assert shown(api, curator, where)["sha256"] == sha256_of(CONTENT)


def test_what_fitted_before_it_could_be_stored_goes_to_the_store(
    disk: Path, platform: Platform, curator: Person
) -> None:
    with client_of(with_place(platform, "store", DISK_BYTES)) as api:
        where = created(api, curator, len(CONTENT), sha256=sha256_of(CONTENT))
        assert refuses_for_want_of_room(patch(api, curator, where, 0, CONTENT))
        offset = offset_of(api, curator, where)
        assert 1 << 20 <= offset < len(CONTENT)
        assert [path.name for path in disk.iterdir()] == ["of-somebody-else"]
        assert patch(api, curator, where, offset, CONTENT[offset:]).status_code == 204
        assert shown(api, curator, where)["sha256"] == sha256_of(CONTENT)
