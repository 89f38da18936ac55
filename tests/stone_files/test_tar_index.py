"""Places of files in tars agree with Python's own reader; what is cut, links elsewhere or lies is refused at once."""

import io
import tarfile
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_files.tar_index import BadTarError, tar_spans_of

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
def test_every_file_is_found_where_tarfile_finds_it(
    tmp_path_factory: pytest.TempPathFactory, files: dict[str, bytes], form: int
) -> None:
    files = {name: content for name, content in files.items() if form != tarfile.USTAR_FORMAT or len(name) <= 100}
    path = packed(tmp_path_factory.mktemp("tar") / "some.tar", files, form)
    assert found(path) == files


def test_a_tar_of_a_folder_is_named_as_below_it(tmp_path: Path) -> None:
    (tmp_path / "folder" / "samples").mkdir(parents=True)
    (tmp_path / "folder" / "samples" / "sweep.bin").write_bytes(b"points")
    with tarfile.open(tmp_path / "some.tar", "w") as tar:
        tar.add(tmp_path / "folder", ".")
    assert found(tmp_path / "some.tar") == {"samples/sweep.bin": b"points"}


def test_names_that_lead_elsewhere_are_not_seen(tmp_path: Path) -> None:
    files = {"../escaped": b"1", "/etc/passwd": b"2", "a/../b": b"3", "._a": b"4", "fine": b"5", "a\\b": b"6"}
    assert found(packed(tmp_path / "some.tar", files)) == {"fine": b"5"}


def test_only_what_is_wanted_is_held(tmp_path: Path) -> None:
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
    with pytest.raises(BadTarError, match="is a link or a device"):
        tar_spans_of(tmp_path / "some.tar", bool)


def test_a_compressed_tar_is_refused_with_a_hint(tmp_path: Path) -> None:
    with tarfile.open(tmp_path / "some.tar.gz", "w:gz") as tar:
        member = tarfile.TarInfo("name")
        member.size = 4000
        tar.addfile(member, io.BytesIO(bytes(range(250)) * 16))
    with pytest.raises(BadTarError, match="is it compressed"):
        tar_spans_of(tmp_path / "some.tar.gz", bool)


@pytest.mark.parametrize("kept", [0, 100, 511, 600, 2000])
def test_a_tar_that_is_cut_off_is_refused(tmp_path: Path, kept: int) -> None:
    path = packed(tmp_path / "some.tar", {"name": b"x" * 3000})
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(BadTarError):
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
    ("at", "field", "why"),
    [
        (124, b"77777777777\0", "should end at byte"),
        (124, b"\x80" + b"\xff" * 11, "should end at byte"),
        (124, b"-1         \0", "is not a number"),
        (124, b"9999       \0", "is not a number"),
    ],
)
def test_sizes_that_lie_are_refused(tmp_path: Path, at: int, field: bytes, why: str) -> None:
    path = forged(packed(tmp_path / "some.tar", {"name": b"x"}), at, field)
    with pytest.raises(BadTarError, match=why):
        tar_spans_of(path, bool)


def test_a_head_that_was_changed_is_refused(tmp_path: Path) -> None:
    path = packed(tmp_path / "some.tar", {"name": b"x"})
    content = bytearray(path.read_bytes())
    content[0] ^= 1
    path.write_bytes(content)
    with pytest.raises(BadTarError, match="the checksum of the header at byte 0 is wrong"):
        tar_spans_of(path, bool)


def test_a_name_of_a_gigabyte_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = packed(tmp_path / "some.tar", {"n" * 200: b"x"}, tarfile.GNU_FORMAT)
    forged(path, 124, b"%011o\0" % 2**30)
    with path.open("r+b") as file:
        file.truncate(2**31)  # a hole: nothing is written
    with pytest.raises(BadTarError, match=f"a name of {2**30} bytes"):
        tar_spans_of(path, bool)


@pytest.mark.parametrize("record", [b"99 path=a\n", b"x path=a\n", b"9 path=a", b"6 a=b\n12 size=-5\n\n", b"0 a=\n"])
def test_a_malformed_record_is_refused(tmp_path: Path, record: bytes) -> None:
    path = packed(tmp_path / "some.tar", {"name": record})
    forged(path, 156, b"x")
    with pytest.raises(BadTarError, match=r"is malformed|is not a size"):
        tar_spans_of(path, bool)
