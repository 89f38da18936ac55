"""A scan of the first bytes of messages goes no further into a compressed chunk than it must."""

from pathlib import Path

import numpy as np
import pytest
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.writer import CompressionType

from stone_recordings.bags import chunked_store, chunks
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import ChecksumError, MalformedBagError
from stone_recordings.bags.message_store import HEAD_BYTES
from tests.stone_recordings.writing import Recorded, write_mcap

IMU = "sensor_msgs/msg/Imu"
HEAD = b"\x00\x01\x00\x00"


def _clouds_last(count: int = 6) -> list[Recorded]:
    """In every chunk a small message or two, then one far larger than a chunk, as a sweep is."""
    rng = np.random.default_rng(5)
    listed = []
    for index in range(count):
        listed += [
            Recorded("/imu", IMU, 3 * index, HEAD + bytes([index]) * 300),
            Recorded("/note", IMU, 3 * index + 1, HEAD + bytes([index]) * (20_000 if index == 2 else 50)),
            Recorded("/cloud", IMU, 3 * index + 2, HEAD + rng.integers(0, 4, 200_000, np.uint8).tobytes()),
        ]
    return listed


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
@pytest.mark.parametrize("whole", [(), ("/note",), ("/cloud",)])
def test_heads_are_the_beginnings_of_messages_and_whole_where_that_was_asked(
    tmp_path: Path, compression: CompressionType, whole: tuple[str, ...]
) -> None:
    messages = _clouds_last()
    path = write_mcap(tmp_path / "run.mcap", messages, compression=compression, chunk_size=1000)
    with open_bag(path) as bag:
        heads = [(name, bytes(payload)) for name, _index, payload in bag.heads(("/imu", "/note", "/cloud"), whole)]
        assert [name for name, _payload in heads] == [message.topic for message in messages]
        for (name, payload), message in zip(heads, messages, strict=True):
            assert message.payload.startswith(payload)
            assert len(payload) >= (len(message.payload) if name in whole else min(HEAD_BYTES, len(message.payload)))


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_scan_inflates_no_cloud_that_lies_behind_what_it_looks_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, compression: CompressionType
) -> None:
    path = write_mcap(tmp_path / "run.mcap", _clouds_last(), compression=compression, chunk_size=1000)
    inflated = []
    real = chunked_store.inflate_head
    monkeypatch.setattr(chunked_store, "inflate_head", lambda *asked: inflated.append(len(got := real(*asked))) or got)
    with open_bag(path) as bag:
        scanned = {name: bytes(payload) for name, _index, payload in bag.heads(("/imu", "/note", "/cloud"))}
        assert all(len(view) < 25_000 for view in bag._store._chunks.values())  # type: ignore[attr-defined]
        assert len(inflated) == 7  # the long note has one of its own
        assert max(inflated) < 10_000
        assert bytes(bag.message("/cloud", 5).payload).startswith(scanned["/cloud"])


def test_of_a_large_lz4_chunk_little_more_is_read_than_the_head_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fed = []

    class Counting(LZ4FrameDecompressor):  # type: ignore[misc]
        def decompress(self, data: bytes, max_length: int = -1) -> bytes:
            fed.append(len(data))
            return bytes(super().decompress(data, max_length))

    noise = np.random.default_rng(6).integers(0, 256, 900_000, np.uint8).tobytes()
    messages = [Recorded("/imu", IMU, 0, HEAD + bytes(300)), Recorded("/cloud", IMU, 1, HEAD + noise)]
    path = write_mcap(tmp_path / "run.mcap", messages, compression=CompressionType.LZ4)
    monkeypatch.setattr(chunks, "LZ4FrameDecompressor", Counting)
    with open_bag(path) as bag:
        assert [name for name, *_ in bag.heads(("/imu", "/cloud"))] == ["/imu", "/cloud"]
    assert 0 < sum(fed) < 200_000


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_damage_before_a_head_is_refused_and_behind_it_when_the_message_is_read(
    tmp_path: Path, compression: CompressionType
) -> None:
    path = write_mcap(tmp_path / "run.mcap", _clouds_last(1), compression=compression, chunk_size=1000)
    sound = path.read_bytes()
    with open_bag(path) as bag:
        chunk = bag._store._placed.chunks[-1]  # type: ignore[attr-defined]
    cut = bytearray(sound)
    cut[chunk.start + 1] ^= 0xFF  # the frame's magic number
    (tmp_path / "early.mcap").write_bytes(cut)
    with open_bag(tmp_path / "early.mcap") as bag, pytest.raises((MalformedBagError, ChecksumError)):
        list(bag.heads(("/imu", "/cloud")))
    late = bytearray(sound)
    late[chunk.stop - 2000] ^= 0xFF
    (tmp_path / "late.mcap").write_bytes(late)
    with open_bag(tmp_path / "late.mcap") as bag:
        assert len(list(bag.heads(("/imu", "/cloud")))) == 2
        with pytest.raises((MalformedBagError, ChecksumError)):
            bag.message("/cloud", 0)
