"""A damaged chunk costs the messages in it: they are told, passed over, and all others are read."""

import threading
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.writer import CompressionType

from stone_files.joined_file import JoinedMember
from stone_recordings.bags import chunked_store, chunks
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.chunked_store import AHEAD_CHUNKS, KEPT_CHUNKS
from stone_recordings.bags.chunks import Chunk, inflate
from stone_recordings.bags.errors import ChecksumError, IngestError, MalformedBagError
from stone_recordings.bags.joined.joined_store import MovedBag
from stone_recordings.bags.message_store import HEAD_BYTES
from testing.worlds.faults.other_edits import bad_chunk
from tests.stone_recordings.writing import Recorded, write_mcap

COUNT = 40
NOISE = np.random.default_rng(3)


def recorded(path: Path, begin: int = 0, **options: object) -> Path:
    """Two topics in small chunks."""
    messages = [
        Recorded(topic, "std_msgs/msg/String", (begin + index) * 1000, bytes([0, 1, 0, 0, index]) + NOISE.bytes(200))
        for index in range(COUNT)
        for topic in ("/a", "/b")
    ]
    return write_mcap(path, messages, chunk_size=1500, **options)


def indices(bag: Bag, topic: str) -> list[int]:
    return [index for name, index, _head in bag.heads(("/a", "/b"), whole=("/a", "/b")) if name == topic]


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_the_messages_of_a_damaged_chunk_are_told_and_passed_over(tmp_path: Path, compression: CompressionType) -> None:
    path = recorded(tmp_path / "run.mcap", compression=compression)
    bad_chunk(path)
    with open_bag(path) as bag:
        damaged = bag.damaged
        assert set(damaged) == {"/a", "/b"}
        for topic in ("/a", "/b"):
            assert 0 < len(damaged[topic]) < COUNT
            assert indices(bag, topic) == [index for index in range(COUNT) if index not in damaged[topic]]
            sound = next(index for index in range(COUNT) if index not in damaged[topic])
            assert bag.message(topic, sound).payload[4] == sound
            with pytest.raises(IngestError):
                bag.message(topic, next(iter(damaged[topic])))
        findings = bag.damage_findings
        assert [(one.code, one.severity, one.topic) for one in findings] == [
            ("BAG-016", "warning", "/a"),
            ("BAG-016", "warning", "/b"),
        ]
        assert f"{len(damaged['/a'])} of {COUNT} messages lie in 1 damaged chunks" in findings[0].message


@pytest.mark.parametrize("compression", [CompressionType.NONE, CompressionType.ZSTD, CompressionType.LZ4])
def test_a_checked_scan_passes_damage_over_that_nobody_asked_for_and_tells_it_then(tmp_path, compression):
    path = recorded(tmp_path / "run.mcap", compression=compression)
    bad_chunk(path)
    with open_bag(path) as bag:
        seen = [(name, index) for name, index, _head in bag.heads(("/a", "/b"), is_checked=True)]
        damaged = bag.damaged
    with open_bag(path) as asked:
        assert damaged == asked.damaged
    sound = [(name, index) for name in ("/a", "/b") for index in range(COUNT) if index not in damaged[name]]
    assert sorted(seen) == sound
    assert len(sound) < 2 * COUNT


def test_of_a_split_recording_the_indices_are_those_of_the_whole(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    recorded(folder / "run_0.mcap")
    bad_chunk(recorded(folder / "run_1.mcap", begin=COUNT))
    with open_bag(folder) as bag:
        damaged = bag.damaged["/a"]
        assert min(damaged) >= COUNT
        assert indices(bag, "/a") == [index for index in range(2 * COUNT) if index not in damaged]
        assert bag.size_bytes("/a", 2 * COUNT - 1) == 205


def test_the_size_of_a_message_is_that_of_all_of_it(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", compression=CompressionType.ZSTD)
    with open_bag(path) as bag:
        assert {bag.size_bytes(name, index) for name, index, _head in bag.heads(("/a", "/b"))} == {205}


@pytest.mark.parametrize("parts", [1, 2])
def test_what_lies_beside_given_messages_is_looked_at_alone(tmp_path: Path, parts: int) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    for part in range(parts):
        bad_chunk(recorded(folder / f"run_{part}.mcap", begin=part * COUNT))
    with open_bag(folder) as bag:
        damaged = bag.damaged
    own, rows = np.array(sorted(damaged["/a"])), np.arange(parts * COUNT)
    with open_bag(folder) as bag:
        bag.believe()
        assert bag.damaged_beside({"/a": own}) == {}
        assert bag.damaged_beside({"/a": np.setdiff1d(rows, own)}) == damaged


def test_of_a_joined_recording_the_messages_beside_are_those_that_are_left(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap")
    bad_chunk(path)
    member = JoinedMember("run.mcap", "0" * 64, 500, left_out={"/a": ((0, 3),)})
    with open_bag(path) as bag:
        own = np.array(sorted(bag.damaged["/a"])) - 3
    moved = MovedBag(open_bag(path), member)
    assert set(moved.damaged()["/a"]) == set(own.tolist())
    assert MovedBag(open_bag(path), member).damaged({"/a": own}) == {}


def test_a_recording_that_is_believed_is_scanned_unchecked_and_checked_where_it_is_read(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", compression=CompressionType.NONE)
    bad_chunk(path)
    with open_bag(path) as bag:
        damaged = next(iter(bag.damaged["/a"]))
    with open_bag(path) as bag:
        bag.believe()
        assert len([index for _name, index, _head in bag.heads(("/a", "/b"), is_checked=True)]) == 2 * COUNT
        assert (bag.damaged, bag.damage_findings) == ({}, ())
        with pytest.raises(ChecksumError):
            bag.message("/a", damaged)


TOPICS = ("/a", "/b")


class CountedInflating:
    """`inflate`, with how often each chunk was inflated and which of them by another thread than the test's."""

    def __init__(self) -> None:
        self.times, self.ahead = Counter[int](), set[int]()

    def __call__(self, view: memoryview, chunk: Chunk) -> memoryview:
        self.times[chunk.start] += 1
        if threading.current_thread() is not threading.main_thread():
            self.ahead.add(chunk.start)
        return inflate(view, chunk)


@pytest.fixture
def inflating(monkeypatch: pytest.MonkeyPatch) -> CountedInflating:
    counted = CountedInflating()
    monkeypatch.setattr(chunked_store, "inflate", counted)
    return counted


@pytest.mark.parametrize("compression", [CompressionType.ZSTD, CompressionType.LZ4])
@pytest.mark.parametrize("is_damaged", [False, True])
def test_every_chunk_is_inflated_once_and_ahead(tmp_path, inflating, compression, is_damaged):
    path = recorded(tmp_path / "run.mcap", compression=compression)
    with open_bag(path) as bag:
        plain = [(name, index, bytes(head)) for name, index, head in bag.heads(TOPICS, whole=TOPICS)]
    if is_damaged:
        bad_chunk(path)
    inflating.times.clear()
    with open_bag(path) as bag:
        checked = [(name, index, bytes(head)) for name, index, head in bag.heads(TOPICS, whole=TOPICS, is_checked=True)]
        assert set(inflating.times.values()) == {1}
        assert inflating.ahead == set(inflating.times)
        damaged = bag.damaged
        assert set(inflating.times.values()) == {1}
    assert checked == [(name, index, head) for name, index, head in plain if index not in damaged.get(name, {})]
    assert bool(damaged) is is_damaged


def test_large_chunks_are_inflated_when_it_is_their_turn(tmp_path, inflating, monkeypatch):
    monkeypatch.setattr(chunked_store, "AHEAD_BYTES", 10)
    with open_bag(recorded(tmp_path / "run.mcap", compression=CompressionType.LZ4)) as bag:
        assert len(list(bag.heads(TOPICS, is_checked=True))) == 80
    assert len(inflating.times) > 3
    assert not inflating.ahead


def test_a_pass_that_is_given_up_leaves_no_thread_and_no_more_chunks(tmp_path, inflating):
    threads = threading.active_count()
    with open_bag(recorded(tmp_path / "run.mcap", compression=CompressionType.LZ4)) as bag:
        heads = bag.heads(TOPICS, is_checked=True)
        next(heads)
        assert threading.active_count() == threads + 1
        heads.close()  # type: ignore[attr-defined]
        assert threading.active_count() == threads
        assert len(inflating.times) <= 1 + AHEAD_CHUNKS
        assert [bag.message("/a", index).payload[4] for index in range(40)] == list(range(40))
        store = bag._store
        assert len(store._chunks) <= KEPT_CHUNKS  # type: ignore[attr-defined]


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
def test_heads_are_the_beginnings_of_messages_and_whole_where_that_was_asked(tmp_path, compression, whole):
    messages = _clouds_last()
    path = write_mcap(tmp_path / "run.mcap", messages, compression=compression, chunk_size=1000)
    with open_bag(path) as bag:
        heads = [(name, bytes(payload)) for name, _index, payload in bag.heads(("/imu", "/note", "/cloud"), whole)]
        assert [name for name, _payload in heads] == [message.topic for message in messages]
        for (name, payload), message in zip(heads, messages, strict=True):
            assert message.payload.startswith(payload)
            assert len(payload) >= (len(message.payload) if name in whole else min(HEAD_BYTES, len(message.payload)))


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_scan_inflates_no_cloud_that_lies_behind_what_it_looks_for(tmp_path, monkeypatch, compression):
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


def test_of_a_large_lz4_chunk_little_more_is_read_than_the_head_takes(tmp_path, monkeypatch):
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
def test_damage_before_a_head_is_refused_and_behind_it_when_the_message_is_read(tmp_path, compression):
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
