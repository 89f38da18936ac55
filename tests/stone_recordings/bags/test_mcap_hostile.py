"""Whatever the bytes, opening and reading gives messages or one coded refusal, and costs little memory."""

import os
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, IndexType

from stone.errors import StoneError
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import CutBagError, MalformedBagError, NotABagError
from stone_recordings.bags.mcap.records import MAGIC
from stone_recordings.report.inspection import inspect
from testing.refusals import refused_as
from tests.stone_recordings.bags.memory_growth import GROWTH_LIMIT_BYTES, growth_of
from tests.stone_recordings.writing import HESAI, POINT_CLOUD, Recorded, cloud_payload, sweep, write_mcap

ROOT = Path(__file__).resolve().parents[3]
KINDS = {
    "plain": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "plain without checksums": {"compression": CompressionType.NONE, "enable_crcs": False},
    "lz4 without checksums": {"compression": CompressionType.LZ4, "enable_crcs": False},
    "unchunked": {"use_chunking": False},
    "walked": {"compression": CompressionType.ZSTD, "index_types": IndexType.NONE},
}


def _cloud_bag(path: Path, **options: object) -> bytes:
    messages = [
        Recorded(topic, POINT_CLOUD, row * 1000, cloud_payload(sweep(HESAI, 20, seed=row)))
        for row in range(6)
        for topic in ("/left", "/right")
    ]
    return write_mcap(path, messages, chunk_size=2000, **options).read_bytes()


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("bags")
    return {kind: _cloud_bag(folder / f"{kind}.mcap", **options) for kind, options in KINDS.items()}


def _read_all(path: Path) -> None:
    """Everything that touches bytes: the catalogue, every payload, the inspection."""
    with open_bag(path) as bag:
        for topic in bag.topics:
            for message in bag.messages(topic.name):
                bytes(message.payload)
    inspect(path)


def _only_coded(path: Path) -> None:
    refusal: StoneError | None = None
    try:
        _read_all(path)
    except StoneError as error:
        refusal = error
    assert refusal is None or (refusal.code and type(refusal) is not StoneError and "\n" not in str(refusal))


@pytest.mark.parametrize("kind", KINDS)
def test_a_recording_cut_anywhere_says_at_which_byte(tmp_path: Path, bags: dict[str, bytes], kind: str) -> None:
    content, path = bags[kind], tmp_path / "cut.mcap"
    for stop in {1, 7, 8, 9, 50, *range(100, len(content), 211), len(content) - 9, len(content) - 1}:
        path.write_bytes(content[:stop])
        with pytest.raises(CutBagError, match=rf"cut off at byte {stop}\b") as caught:
            open_bag(path)
        assert caught.value.code == "BAG-010"


@settings(max_examples=80, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    kind=st.sampled_from(sorted(KINDS)),
    ratio=st.floats(0, 1, exclude_max=True),
    value=st.binary(min_size=1, max_size=9),
)
def test_no_overwritten_bytes_give_anything_but_messages_or_a_coded_refusal(tmp_path, bags, kind, ratio, value):
    content = bytearray(bags[kind])
    at = int(ratio * len(content))
    content[at : at + len(value)] = value[: len(content) - at]
    path = tmp_path / "damaged.mcap"
    path.write_bytes(content)
    _only_coded(path)


@pytest.mark.whole
@pytest.mark.parametrize("kind", ["plain without checksums", "lz4 without checksums", "unchunked", "walked"])
def test_no_lying_length_anywhere_gives_anything_but_a_coded_refusal(tmp_path, bags, kind):
    """Every length, count and offset of every record, set to values that have killed readers."""
    content, path = bags[kind], tmp_path / "lying.mcap"
    for at in _integer_places(content):
        for lie in (0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 1 << 62, (1 << 64) - 1, len(content)):
            damaged = bytearray(content)
            damaged[at : at + 8] = struct.pack("<Q", lie)[: len(content) - at]
            path.write_bytes(damaged)
            _only_coded(path)


def _integer_places(content: bytes) -> list[int]:
    """Where the records start, and the fields in their first bytes; at most 40 a file."""
    places, at = [], len(MAGIC)
    while at < len(content) - len(MAGIC):
        (length,) = struct.unpack_from("<Q", content, at + 1)
        places += [at + 1, *range(at + 9, at + 9 + min(length, 48), 4)]
        at += 9 + length
    return places[:: max(1, len(places) // 40)]


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300), has_magic=st.booleans(), has_end=st.booleans())
def test_random_bytes_are_refused(tmp_path: Path, content: bytes, has_magic: bool, has_end: bool) -> None:
    path = tmp_path / "random.mcap"
    path.write_bytes((MAGIC if has_magic else b"") + content + (MAGIC if has_end else b""))
    with pytest.raises(StoneError):
        open_bag(path)


@pytest.mark.parametrize(
    ("first", "looks_like"),
    [
        (b"<!DOCTYPE html><html><title>Sign in</title></html>", "an HTML page"),
        (b"\n\n <HTML lang=en>", "an HTML page"), (b"#ROSBAG V1.2\n", "a ROS 1 bag of a version before 2.0"),
        (b"PK\x03\x04\x14\x00", "a zip archive"), (b"\x28\xb5\x2f\xfd\x04", "compressed with zstd"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a Git LFS pointer"), (b'{"message": "Not Found"}', "JSON"),
        (b"hello there", "plain text"), (b"<?xml version='1.0'?><Error/>", "XML"),
        (b"\x00" * 257 + b"ustar\x00", "a tar archive"), (b"\x00\x01\x02\x03", "an unknown format"),
        (b"", "an empty file"),
    ],
)  # fmt: skip
def test_what_is_no_bag_is_named_by_its_first_bytes(tmp_path: Path, first: bytes, looks_like: str) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(first)
    with pytest.raises(NotABagError, match=looks_like) as caught:
        open_bag(path)
    assert caught.value.code == "BAG-001"
    assert first[:4].hex(" ") in str(caught.value)


def test_a_missing_file_is_missing_and_an_ordinary_folder_no_bag(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        open_bag(tmp_path / "absent.mcap")
    with pytest.raises(NotABagError):
        open_bag(tmp_path)


def _with_chunk(compression: bytes, declared_bytes: int, packed: bytes) -> bytes:
    """A file of one chunk and nothing else, which must be walked."""
    chunk = struct.pack("<QQQII", 0, 0, declared_bytes, 0, len(compression)) + compression
    chunk += struct.pack("<Q", len(packed)) + packed
    records = [(1, struct.pack("<II", 0, 0)), (6, chunk), (15, bytes(4)), (2, bytes(20))]
    return MAGIC + b"".join(struct.pack("<BQ", code, len(body)) + body for code, body in records) + MAGIC


def _packed(compression: str, size_bytes: int) -> bytes:
    import cramjam

    codec = cramjam.lz4 if compression == "lz4" else cramjam.zstd
    return bytes(codec.compress(np.zeros(size_bytes, np.uint8)))


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
@pytest.mark.parametrize("declared_bytes", [10, 999, 1001, 100_000_000])
def test_a_chunk_that_inflates_to_another_size_is_refused(tmp_path, compression, declared_bytes):
    path = tmp_path / "lying.mcap"
    path.write_bytes(_with_chunk(compression.encode(), declared_bytes, _packed(compression, 1000)))
    with pytest.raises(MalformedBagError):
        open_bag(path)


def test_an_unknown_compression_and_an_uncompressed_lie_are_named(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(_with_chunk(b"br", 10, b"0123456789"))
    with refused_as("BAG-017"):
        open_bag(path)
    path.write_bytes(_with_chunk(b"", 11, b"0123456789"))
    with pytest.raises(MalformedBagError):
        open_bag(path)


def _bomb(compression: str, declared_bytes: int, true_bytes: int) -> Callable[[], bytes]:
    return lambda: _with_chunk(compression.encode(), declared_bytes, _packed(compression, true_bytes))


BOMBS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "ten gigabytes": ("BAG-013", _bomb("zstd", 10_000_000_000, 120_000_000)),
    "zstd that grows beyond its word": ("BAG-012", _bomb("zstd", 120_000_000, 220_000_000)),
    "lz4 that grows beyond its word": ("BAG-012", _bomb("lz4", 120_000_000, 220_000_000)),
    "a hole of 400 megabytes": ("BAG-010", lambda: MAGIC),
}


@pytest.mark.whole
@pytest.mark.parametrize("name", BOMBS)
def test_a_refusal_costs_little_memory(tmp_path: Path, name: str) -> None:
    code, content = BOMBS[name]
    path = tmp_path / "bomb.mcap"
    path.write_bytes(content())
    if code == "BAG-010":
        os.truncate(path, 400_000_000)
    said, growth_bytes = growth_of(path)
    assert said == code
    assert growth_bytes <= GROWTH_LIMIT_BYTES
