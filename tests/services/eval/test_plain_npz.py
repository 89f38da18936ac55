"""What is recognised at a glance is what the full reader reads; whatever else is left to it."""

import io
import zipfile
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone_files.npz import npz_bytes
from stone_submissions.errors import SubmissionError
from stone_submissions.npz_frame import PLAIN_NAMES
from stone_submissions.plain_npz import plain_member
from stone_submissions.zip_directory import ZipMember, payload_span, read_directory

GRID = np.arange(60, dtype=np.uint8)


def written(write: Callable[..., None], *arrays: object, **named: object) -> bytes:
    file = io.BytesIO()
    write(file, *arrays, **named)
    return file.getvalue()


def zipped(name: str, comment: bytes = b"") -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, GRID.tobytes())
        archive.comment = comment
    return file.getvalue()


USUAL = (
    written(np.savez_compressed, semantics=GRID),
    written(np.savez, semantics=GRID),
    written(np.savez_compressed, GRID),
    written(np.savez, GRID),
    npz_bytes({"semantics": GRID}),
    zipped("semantics.npy"),
)
UNUSUAL = (
    written(np.savez_compressed, semantics=GRID, other=GRID),
    written(np.savez_compressed, labels=GRID),
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


@settings(max_examples=300, deadline=None)
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
