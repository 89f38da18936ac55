"""Archives laid out but never built: the standard library opens them, and any range is the slice of the whole."""

import io
import shutil
import subprocess
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import StoneError
from stone_files import archives
from stone_files.archives import tar_spans_of
from testing.refusals import refused_as

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
        archives.check_names(name for name, _ in files)
    except StoneError as error:
        if error.code != "bad_member":
            raise
        return False
    return True


def members_of(files: list[tuple[str, bytes]]) -> archives.ArchiveMembers:
    sizes = np.array([len(content) for _, content in files], np.int64)
    sums = np.array([zlib.crc32(content) for _, content in files], np.uint32)
    return archives.ArchiveMembers([name for name, _ in files], sizes, sums)


def bytes_of(archive: archives.Archive, files: list[tuple[str, bytes]], start: int, stop: int) -> bytes:
    found = bytearray()
    for segment in archive.segments(start, stop):
        assert len(segment) > 0
        found += (
            files[segment.ordinal][1][segment.start : segment.stop]
            if isinstance(segment, archives.ArchiveMemberRange)
            else segment
        )
    return bytes(found)


def unpacked(payload: bytes, kind: archives.Kind) -> list[tuple[str, bytes]]:
    if kind == "zip":
        with zipfile.ZipFile(io.BytesIO(payload)) as archive:
            assert archive.testzip() is None
            return [(name, archive.read(name)) for name in archive.namelist()]
    with tarfile.open(fileobj=io.BytesIO(payload), mode="r:") as archive:
        assert {member.mode for member in archive} <= {0o644}
        return [(member.name, archive.extractfile(member).read()) for member in archive]  # type: ignore[union-attr]


@pytest.mark.parametrize("kind", archives.KINDS)
@given(files=contents.filter(is_allowed), data=st.data())
@settings(max_examples=30)
def test_an_archive_unpacks_to_its_members_and_every_range_is_the_slice(kind, files, data):
    archive = archives.layout(members_of(files), kind)
    whole = bytes_of(archive, files, 0, archive.size_bytes)
    assert len(whole) == archive.size_bytes
    assert unpacked(whole, kind) == files
    start = data.draw(st.integers(0, archive.size_bytes))
    stop = data.draw(st.integers(start, archive.size_bytes + 5))
    assert bytes_of(archive, files, start, stop) == whole[start:stop]
    assert bytes_of(archives.layout(members_of(files), kind), files, 0, archive.size_bytes) == whole


class Virtual(io.RawIOBase):
    """A file that is read through the layout; large members are zeros that nobody stores."""

    def __init__(self, archive: archives.Archive, small: dict[int, bytes]) -> None:
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


@pytest.mark.parametrize("kind", archives.KINDS)
@given(sizes=sizes_of_large)
@settings(max_examples=40)
def test_sizes_and_offsets_beyond_32_bits_are_read_back(kind: archives.Kind, sizes: list[int]) -> None:
    """The small file behind them all is found, and its bytes are its own."""
    names = [f"samples/{'x' * 90 * (number % 2)}{number}.pcd" for number in range(len(sizes))] + ["last.txt"]
    sums = np.array([0] * len(sizes) + [zlib.crc32(LAST)], np.uint32)
    archive = archives.layout(archives.ArchiveMembers(names, np.array([*sizes, len(LAST)], np.int64), sums), kind)
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
    members = archives.ArchiveMembers(
        [f"{number:06d}" for number in range(count)], np.zeros(count, np.int64), np.zeros(count, np.uint32)
    )
    with zipfile.ZipFile(Virtual(archives.layout(members, "zip"), {})) as opened:
        assert len(opened.namelist()) == count


@pytest.mark.parametrize(
    "name",
    ["", "/etc/passwd", "../up", "a/../../b", "a//b", "a/", "./a", ".hidden", "a/.b", "a\\b", "C:x", "a\0", "ä", "a b",
     "a\n", "x" * 513],
)  # fmt: skip
def test_a_name_that_could_leave_its_folder_is_refused(name: str) -> None:
    with refused_as("bad_member"):
        archives.check_names(["fine.txt", name])


@pytest.mark.parametrize("both", [("a", "a"), ("a.txt", "A.TXT"), ("a", "a/b"), ("A/b", "a"), ("a/b/c", "a/B")])
def test_two_files_that_would_be_one_are_refused(both: tuple[str, str]) -> None:
    with refused_as("bad_member"):
        archives.check_names(both)


@pytest.mark.parametrize("command", [("tar", "-xf"), ("unzip", "-q")])
def test_the_commands_people_have_unpack_it(tmp_path: Path, command: tuple[str, ...]) -> None:
    if shutil.which(command[0]) is None:
        pytest.skip(f"{command[0]} is not on this machine")
    files = [("gts/a/labels.npz", b"x" * 700), (f"samples/{'y' * 120}/{'z' * 110}.jpg", b"jpg"), ("sha256sum.txt", b"")]
    archive = archives.layout(members_of(files), "tar" if command[0] == "tar" else "zip")
    (tmp_path / "archive").write_bytes(bytes_of(archive, files, 0, archive.size_bytes))
    outcome = subprocess.run([*command, "archive"], cwd=tmp_path, check=False, capture_output=True, text=True)
    assert (outcome.returncode, outcome.stderr) == (0, "")
    assert {name: (tmp_path / name).read_bytes() for name, _ in files} == dict(files)


PARTS = st.text("abcXYZ019_-", min_size=1, max_size=60)
NAMES = st.lists(PARTS, min_size=1, max_size=5).map("/".join)
FORMATS = (tarfile.USTAR_FORMAT, tarfile.GNU_FORMAT, tarfile.PAX_FORMAT)


def packed(path: Path, files: dict[str, bytes], form: int = tarfile.PAX_FORMAT) -> Path:
    with tarfile.open(path, "w", format=form) as tar:
        for name, content in files.items():
            member = tarfile.TarInfo(name)
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    return path


def found(path: Path, is_wanted: Callable[[str], bool] = lambda name: True) -> dict[str, bytes]:
    content = path.read_bytes()
    return {name: content[at : at + size] for name, (at, size) in tar_spans_of(path, is_wanted).items()}


@given(files=st.dictionaries(NAMES, st.binary(max_size=1200), max_size=6), form=st.sampled_from(FORMATS))
def test_every_file_is_found_where_tarfile_finds_it(tmp_path_factory, files, form):
    files = {name: content for name, content in files.items() if form != tarfile.USTAR_FORMAT or len(name) <= 100}
    path = packed(tmp_path_factory.mktemp("tar") / "some.tar", files, form)
    assert found(path) == files


def test_a_tar_of_a_folder_is_named_as_below_it(tmp_path: Path) -> None:
    (tmp_path / "folder" / "samples").mkdir(parents=True)
    (tmp_path / "folder" / "samples" / "sweep.bin").write_bytes(b"points")
    with tarfile.open(tmp_path / "some.tar", "w") as tar:
        tar.add(tmp_path / "folder", ".")
    assert found(tmp_path / "some.tar") == {"samples/sweep.bin": b"points"}


def test_names_that_lead_elsewhere_are_not_seen_nor_what_is_not_wanted(tmp_path: Path) -> None:
    files = {"../escaped": b"1", "/etc/passwd": b"2", "a/../b": b"3", "._a": b"4", "fine": b"5", "a\\b": b"6"}
    assert found(packed(tmp_path / "some.tar", files)) == {"fine": b"5"}
    path = packed(tmp_path / "some.tar", {"a.json": b"1", "b.jpg": b"2"})
    assert found(path, lambda name: name.endswith(".json")) == {"a.json": b"1"}


def test_the_last_of_two_files_of_one_name_counts_as_when_unpacked(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "some.tar", "w") as tar:
        for content in (b"first", b"second"):
            member = tarfile.TarInfo("name")
            member.size = len(content)
            tar.addfile(member, io.BytesIO(content))
    assert found(tmp_path / "some.tar") == {"name": b"second"}


@pytest.mark.parametrize("kind", [tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE])
def test_links_and_devices_are_refused(tmp_path: Path, kind: bytes) -> None:
    with tarfile.open(tmp_path / "some.tar", "w") as tar:
        member = tarfile.TarInfo("sweep")
        member.type, member.linkname = kind, "/dev/zero"
        tar.addfile(member)
    with refused_as("bad_tar"):
        tar_spans_of(tmp_path / "some.tar", bool)


def test_a_compressed_tar_is_refused_with_a_hint(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "some.tar.gz", "w:gz") as tar:
        member = tarfile.TarInfo("name")
        member.size = 4000
        tar.addfile(member, io.BytesIO(bytes(range(250)) * 16))
    with refused_as("bad_tar"):
        tar_spans_of(tmp_path / "some.tar.gz", bool)


@pytest.mark.parametrize("kept", [0, 100, 511, 600, 2000])
def test_a_tar_that_is_cut_off_is_refused(tmp_path: Path, kept: int) -> None:
    path = packed(tmp_path / "some.tar", {"name": b"x" * 3000})
    path.write_bytes(path.read_bytes()[:kept])
    with refused_as("bad_tar"):
        tar_spans_of(path, bool)


def forged(path: Path, at: int, field: bytes) -> Path:
    """The tar with other bytes in its first head, and the checksum that goes with them."""
    content = bytearray(path.read_bytes())
    content[at : at + len(field)] = field
    content[148:156] = b" " * 8
    content[148:156] = b"%06o\0 " % sum(content[:512])
    path.write_bytes(content)
    return path


@pytest.mark.parametrize(
    ("at", "field"),
    [(124, b"77777777777\0"), (124, b"\x80" + b"\xff" * 11), (124, b"-1         \0"), (124, b"9999       \0")],
)
def test_sizes_that_lie_are_refused(tmp_path: Path, at: int, field: bytes) -> None:
    path = forged(packed(tmp_path / "some.tar", {"name": b"x"}), at, field)
    with refused_as("bad_tar"):
        tar_spans_of(path, bool)


def test_a_head_that_was_changed_is_refused(tmp_path: Path) -> None:
    path = packed(tmp_path / "some.tar", {"name": b"x"})
    content = bytearray(path.read_bytes())
    content[0] ^= 1
    path.write_bytes(content)
    with refused_as("bad_tar"):
        tar_spans_of(path, bool)


def test_a_name_of_a_gigabyte_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = packed(tmp_path / "some.tar", {"n" * 200: b"x"}, tarfile.GNU_FORMAT)
    forged(path, 124, b"%011o\0" % 2**30)
    with path.open("r+b") as file:
        file.truncate(2**31)  # a hole: nothing is written
    with refused_as("bad_tar"):
        tar_spans_of(path, bool)


@pytest.mark.parametrize("record", [b"99 path=a\n", b"x path=a\n", b"9 path=a", b"6 a=b\n12 size=-5\n\n", b"0 a=\n"])
def test_a_malformed_record_is_refused(tmp_path: Path, record: bytes) -> None:
    path = packed(tmp_path / "some.tar", {"name": record})
    forged(path, 156, b"x")
    with refused_as("bad_tar"):
        tar_spans_of(path, bool)
