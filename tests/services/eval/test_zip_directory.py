"""The directory reader agrees with zipfile on honest archives and never lets a damaged one through unseen."""

import io
import zipfile
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_files.npz import npz_bytes
from stone_submissions.errors import SubmissionError
from stone_submissions.npz_frame import PLAIN_NAMES, plain_member, prediction_grid
from stone_submissions.zip_directory import ZipMember, payload_span, read_directory
from testing.refusals import refused_as
from tests.services.eval.attacks import grid, saved, stored

PREDICTION = grid()
NPZ = npz_bytes({"semantics": PREDICTION})


def reader(raw: bytes) -> Callable[[int, int], bytes]:
    return lambda offset, count: raw[offset : offset + count]


def archive_of(files: dict[str, bytes], method: int, comment: bytes = b"") -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", method) as opened:
        opened.comment = comment
        for name, payload in files.items():
            opened.writestr(name, payload)
    return file.getvalue()


@given(
    st.dictionaries(st.text("abé/.", min_size=1, max_size=20), st.binary(max_size=60), max_size=6),
    st.sampled_from([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED]),
    st.binary(max_size=40).filter(lambda comment: b"PK\5\6" not in comment),
)
def test_honest_archives_are_read_as_zipfile_reads_them(files: dict[str, bytes], method: int, comment: bytes) -> None:
    raw = archive_of(files, method, comment)
    members = read_directory(reader(raw), len(raw), 10)
    with zipfile.ZipFile(io.BytesIO(raw)) as opened:
        for member, info in zip(members, opened.infolist(), strict=True):
            facts = (member.name, member.crc32, member.packed_bytes, member.unpacked_bytes, member.offset)
            assert facts == (info.filename, info.CRC, info.compress_size, info.file_size, info.header_offset)
            start, stop = payload_span(reader(raw), member)
            assert stop - start == info.compress_size
            if method == zipfile.ZIP_STORED:
                assert raw[start:stop] == files[member.name]


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_a_submission_cut_off_anywhere_is_called_cut_short(method: int) -> None:
    """Where frames are stored, the last end record of what is left is that of a frame."""
    whole = archive_of({f"{number}.npz": NPZ for number in range(4)}, method)
    inner = [place + 22 for place in range(len(whole)) if whole.startswith(b"PK\5\6", place)]
    cuts = {*range(4, len(whole), len(whole) // 40), *(place for place in inner if place < len(whole)), len(whole) - 1}
    for stop in sorted(cuts):
        raw = whole[:stop]
        with refused_as("truncated"):
            read_directory(reader(raw), len(raw), 10)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_bytes_behind_a_whole_archive_are_told_from_a_cut(method: int, monkeypatch: pytest.MonkeyPatch) -> None:
    files = {f"{number}.npz": NPZ for number in range(4)}
    narrow = archive_of(files, method)
    monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 2)
    for whole in (narrow, archive_of(files, method)):
        with refused_as("not_zip", match="found 1 bytes more"):
            read_directory(reader(whole + b"x"), len(whole) + 1, 10)


@pytest.mark.parametrize("raw", [b"", b"PK\3", b"<!DOCTYPE html><html>", b"PK\5\6", b"\0" * 100])
def test_what_does_not_begin_as_a_zip_is_none(raw: bytes) -> None:
    with refused_as("not_zip"):
        read_directory(reader(raw), len(raw), 10)


@pytest.mark.parametrize(
    ("shape", "steps"),
    [
        ((32, 256, 256), ["grid.transpose(1, 2, 0)", "grid.transpose(2, 1, 0)"]),
        ((256, 32, 256), ["grid.transpose(0, 2, 1)", "grid.transpose(2, 0, 1)"]),
        ((1, 256, 256, 32), ["grid[0]"]),
        ((256, 256, 32, 1), ["grid[..., 0]"]),
        ((4, 256, 256, 32), ["grid.argmax(0)"]),
        ((256, 256, 32, 4), ["grid.argmax(-1)"]),
    ],
)
def test_the_hint_for_a_shape_makes_it_the_right_one(shape: tuple[int, ...], steps: list[str]) -> None:
    hint = str(SubmissionError("bad_shape", "(256, 256, 32)", str(shape)))
    for step in steps:
        assert step in hint
        assert eval(step, {"grid": np.zeros(shape, np.uint8)}).shape == (256, 256, 32)
    assert "ascontiguousarray" not in hint


def test_zip64_end_records_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 2)
    monkeypatch.setattr(zipfile, "ZIP64_LIMIT", 50)
    files = {f"{index}": bytes([index]) * 60 for index in range(4)}
    raw = archive_of(files, zipfile.ZIP_STORED)
    assert b"PK\6\6" in raw
    members = read_directory(reader(raw), len(raw), 10)
    assert {member.name: raw[slice(*payload_span(reader(raw), member))] for member in members} == files
    with refused_as("too_large", match="at most 3 files in the archive, found 4"):
        read_directory(reader(raw), len(raw), 3)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, len(NPZ) * 8 - 1))
def test_no_flipped_bit_changes_a_grid_unseen(bit: int) -> None:
    damaged = bytearray(NPZ)
    damaged[bit // 8] ^= 1 << bit % 8
    try:
        found = prediction_grid(damaged)
    except SubmissionError:
        return
    np.testing.assert_array_equal(found, PREDICTION)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, len(NPZ) - 1))
def test_every_cut_is_refused(length: int) -> None:
    with pytest.raises(SubmissionError):
        prediction_grid(NPZ[:length])


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_no_damage_to_the_frame_of_an_archive_escapes_as_another_error(data: st.DataObject) -> None:
    """Headers, directory and end record: where the structure is."""
    damaged = bytearray(NPZ)
    for _ in range(data.draw(st.integers(1, 4))):
        near_start = data.draw(st.booleans())
        place = data.draw(st.integers(0, 60) if near_start else st.integers(len(NPZ) - 90, len(NPZ) - 1))
        damaged[place] = data.draw(st.integers(0, 255))
    try:
        found = prediction_grid(damaged)
    except SubmissionError:
        return
    np.testing.assert_array_equal(found, PREDICTION)


@pytest.mark.parametrize("npz", [NPZ, saved(semantics=PREDICTION), saved(PREDICTION), stored(PREDICTION)])
def test_every_honest_writer_is_read(npz: bytes) -> None:
    np.testing.assert_array_equal(prediction_grid(npz), PREDICTION)


NUMBERS = np.arange(60, dtype=np.uint8)


def written(write: Callable[..., None], *arrays: object, **named: object) -> bytes:
    file = io.BytesIO()
    write(file, *arrays, **named)
    return file.getvalue()


def zipped(name: str, comment: bytes = b"") -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, NUMBERS.tobytes())
        archive.comment = comment
    return file.getvalue()


USUAL = (
    written(np.savez_compressed, semantics=NUMBERS),
    written(np.savez, semantics=NUMBERS),
    written(np.savez_compressed, NUMBERS),
    written(np.savez, NUMBERS),
    npz_bytes({"semantics": NUMBERS}),
    zipped("semantics.npy"),
)
UNUSUAL = (
    written(np.savez_compressed, semantics=NUMBERS, other=NUMBERS),
    written(np.savez_compressed, labels=NUMBERS),
    zipped("semantics.npy", b"made by hand"),
    zipped("semantics"),
    b"before" + USUAL[0],
    USUAL[0] + b"behind",
    USUAL[0][:-1],
    USUAL[0][:60],
    b"",
)


def in_full(npz: bytes) -> tuple[ZipMember, int] | None:
    """What the full reader makes of it; None where it refuses."""

    def read_at(offset: int, count: int) -> bytes:
        return npz[offset : offset + count]

    try:
        (member,) = read_directory(read_at, len(npz), 1)
        start, stop = payload_span(read_at, member)
    except SubmissionError:
        return None
    assert stop == member.limit
    return member, start


@pytest.mark.parametrize("npz", USUAL)
def test_what_numpy_and_we_write_is_recognised_as_it_is_read(npz: bytes) -> None:
    found = plain_member(npz, PLAIN_NAMES)
    assert found is not None
    assert found == in_full(npz)
    assert found == plain_member(memoryview(npz), PLAIN_NAMES) == plain_member(bytearray(npz), PLAIN_NAMES)


@pytest.mark.parametrize("npz", UNUSUAL)
def test_whatever_is_unusual_is_left_to_the_full_reader(npz: bytes) -> None:
    assert plain_member(npz, PLAIN_NAMES) is None


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(USUAL), st.lists(st.tuples(st.integers(0, 170), st.integers(0, 255)), min_size=1, max_size=3))
def test_nothing_is_recognised_that_the_full_reader_would_refuse_or_read_otherwise(
    npz: bytes, changes: list[tuple[int, int]]
) -> None:
    """Bytes of the headers, at either end, are changed."""
    spoiled = bytearray(npz)
    for place, value in changes:
        spoiled[(place if place < 70 else place - 170) % len(npz)] = value
    found = plain_member(bytes(spoiled), PLAIN_NAMES)
    assert found is None or found == in_full(bytes(spoiled))


def test_every_single_changed_header_byte_is_read_alike_or_left() -> None:
    recognised = 0
    for npz in USUAL:
        for place in [*range(70), *range(len(npz) - 90, len(npz))]:
            for value in {0, 1, 7, 80, 255, npz[place] ^ 1, npz[place] ^ 128}:
                spoiled = npz[:place] + bytes([value]) + npz[place + 1 :]
                found = plain_member(spoiled, PLAIN_NAMES)
                recognised += found is not None
                assert found is None or found == in_full(spoiled)
    assert recognised > 100
