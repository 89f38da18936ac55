"""Archives laid out but never built: the standard library opens them, and any range is the slice of the whole."""

import io
import shutil
import subprocess
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_files.virtual_archive import (
    KINDS,
    Archive,
    ArchiveMemberRange,
    ArchiveMembers,
    BadMemberError,
    Kind,
    check_names,
    layout,
)

SIGNS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_+=@-"
parts = st.text(SIGNS, min_size=1, max_size=130).flatmap(
    lambda head: st.sampled_from([head, f"{head}.npz", f"{head}.x"])
)
names = st.lists(parts, min_size=1, max_size=4).map("/".join).filter(lambda name: len(name) <= 512)
contents = st.lists(st.tuples(names, st.binary(max_size=1500)), max_size=8, unique_by=lambda pair: pair[0])
GIB = 2**30
LAST = b"the last of them"


def is_allowed(files: list[tuple[str, bytes]]) -> bool:
    try:
        check_names(name for name, _ in files)
    except BadMemberError:
        return False
    return True


def members_of(files: list[tuple[str, bytes]]) -> ArchiveMembers:
    sizes = np.array([len(content) for _, content in files], np.int64)
    sums = np.array([zlib.crc32(content) for _, content in files], np.uint32)
    return ArchiveMembers([name for name, _ in files], sizes, sums)


def bytes_of(archive: Archive, files: list[tuple[str, bytes]], start: int, stop: int) -> bytes:
    found = bytearray()
    for segment in archive.segments(start, stop):
        assert len(segment) > 0
        found += (
            files[segment.ordinal][1][segment.start : segment.stop]
            if isinstance(segment, ArchiveMemberRange)
            else segment
        )
    return bytes(found)


def unpacked(payload: bytes, kind: Kind) -> list[tuple[str, bytes]]:
    if kind == "zip":
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            assert archive.testzip() is None
            return [(name, archive.read(name)) for name in archive.namelist()]
    with tarfile.open(fileobj=io.BytesIO(payload), mode="r:") as archive:
        assert {member.mode for member in archive} <= {0o644}
        return [(member.name, archive.extractfile(member).read()) for member in archive]  # type: ignore[union-attr]


@pytest.mark.parametrize("kind", KINDS)
@given(files=contents.filter(is_allowed), data=st.data())
@settings(max_examples=60, deadline=None)
def test_an_archive_unpacks_to_its_members_and_every_range_is_the_slice(
    kind: Kind, files: list[tuple[str, bytes]], data: st.DataObject
) -> None:
    archive = layout(members_of(files), kind)
    whole = bytes_of(archive, files, 0, archive.size_bytes)
    assert len(whole) == archive.size_bytes
    assert unpacked(whole, kind) == files
    start = data.draw(st.integers(0, archive.size_bytes))
    stop = data.draw(st.integers(start, archive.size_bytes + 5))
    assert bytes_of(archive, files, start, stop) == whole[start:stop]
    assert bytes_of(layout(members_of(files), kind), files, 0, archive.size_bytes) == whole


class Virtual(io.RawIOBase):
    """A file that is read through the layout; large members are zeros that nobody stores."""

    def __init__(self, archive: Archive, small: dict[int, bytes]) -> None:
        self._archive, self._small, self._place = archive, small, 0

    def seekable(self) -> bool:
        return True

    def readable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = 0) -> int:
        self._place = offset + (0, self._place, self._archive.size_bytes)[whence]
        return self._place

    def tell(self) -> int:
        return self._place

    def readall(self) -> bytes:
        return self.read(self._archive.size_bytes - self._place)

    def read(self, size: int = -1) -> bytes:
        if size < 0:
            return self.readall()
        found = b"".join(self._bytes(self._place, self._place + size))
        self._place += len(found)
        return found

    def _bytes(self, start: int, stop: int) -> Iterator[bytes]:
        for segment in self._archive.segments(start, stop):
            if isinstance(segment, bytes):
                yield segment
            elif segment.ordinal in self._small:
                yield self._small[segment.ordinal][segment.start : segment.stop]
            else:
                yield bytes(len(segment))


sizes_of_large = st.lists(
    st.one_of(st.integers(0, 2000), st.integers(4 * GIB - 3, 4 * GIB + 3), st.integers(8 * GIB - 3, 20 * GIB)),
    min_size=1,
    max_size=6,
)


@pytest.mark.parametrize("kind", KINDS)
@given(sizes=sizes_of_large)
@settings(max_examples=40, deadline=None)
def test_sizes_and_offsets_beyond_32_bits_are_read_back(kind: Kind, sizes: list[int]) -> None:
    """The small file behind them all is found, and its bytes are its own."""
    names = [f"samples/{'x' * 90 * (number % 2)}{number}.pcd" for number in range(len(sizes))] + ["last.txt"]
    sums = np.array([0] * len(sizes) + [zlib.crc32(LAST)], np.uint32)
    archive = layout(ArchiveMembers(names, np.array([*sizes, len(LAST)], np.int64), sums), kind)
    file = Virtual(archive, {len(sizes): LAST})
    if kind == "zip":
        with zipfile.ZipFile(file) as opened:
            found = [(info.filename, info.file_size, info.compress_size) for info in opened.infolist()]
            assert opened.read("last.txt") == LAST
            assert [info.orig_filename for info in opened.infolist()] == names
    else:
        with tarfile.open(fileobj=file, mode="r:") as opened_tar:
            found = [(member.name, member.size, member.size) for member in opened_tar]
            assert opened_tar.extractfile("last.txt").read() == LAST  # type: ignore[union-attr]
    assert found == [(name, size, size) for name, size in zip(names, [*sizes, len(LAST)], strict=True)]


def test_more_members_than_16_bits_count_are_listed() -> None:
    count = 70_000
    members = ArchiveMembers(
        [f"{number:06d}" for number in range(count)], np.zeros(count, np.int64), np.zeros(count, np.uint32)
    )
    with zipfile.ZipFile(Virtual(layout(members, "zip"), {})) as opened:
        assert len(opened.namelist()) == count


@pytest.mark.parametrize(
    "name",
    ["", "/etc/passwd", "../up", "a/../../b", "a//b", "a/", "./a", ".hidden", "a/.b", "a\\b", "C:x", "a\0", "ä", "a b",
     "a\n", "x" * 513],
)  # fmt: skip
def test_a_name_that_could_leave_its_folder_is_refused(name: str) -> None:
    with pytest.raises(BadMemberError, match="cannot be a file of an archive"):
        check_names(["fine.txt", name])


@pytest.mark.parametrize("both", [("a", "a"), ("a.txt", "A.TXT"), ("a", "a/b"), ("A/b", "a"), ("a/b/c", "a/B")])
def test_two_files_that_would_be_one_are_refused(both: tuple[str, str]) -> None:
    with pytest.raises(BadMemberError, match=r"another file of that name|a folder has the same name"):
        check_names(both)


@pytest.mark.parametrize("command", [("tar", "-xf"), ("unzip", "-q")])
def test_the_commands_people_have_unpack_it(tmp_path: Path, command: tuple[str, ...]) -> None:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not on this machine")
    files = [("gts/a/labels.npz", b"x" * 700), (f"samples/{'y' * 120}/{'z' * 110}.jpg", b"jpg"), ("sha256sum.txt", b"")]
    archive = layout(members_of(files), "tar" if command[0] == "tar" else "zip")
    (tmp_path / "archive").write_bytes(bytes_of(archive, files, 0, archive.size_bytes))
    outcome = subprocess.run([*command, "archive"], cwd=tmp_path, check=False, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert {name: (tmp_path / name).read_bytes() for name, _ in files} == dict(files)
