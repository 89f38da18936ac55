"""What is whole of a recording that was cut off is kept, what is lost is said, and the original stays as it was."""

import os
import signal
import struct
import subprocess
import sys
from collections.abc import Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path
from struct import pack, unpack_from
from tempfile import TemporaryDirectory

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Message
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Reader

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import CutBagError, MalformedBagError
from stone_recordings.bags.mcap.records import MAGIC
from stone_recordings.bags.recovery.recovery import Recovery, recover
from testing.refusals import refused_as
from tests.stone_recordings.bags.memory_growth import GROWTH_LIMIT_BYTES, growth_of
from tests.stone_recordings.databases import write_db3
from tests.stone_recordings.writing import Recorded, write_mcap

ROOT = Path(__file__).resolve().parents[4]
IMU = "sensor_msgs/msg/Imu"
KINDS = {
    "plain": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "unchunked": {"use_chunking": False},
    "unindexed": {"compression": CompressionType.ZSTD, "index_types": IndexType.NONE, "use_statistics": False},
}


def _messages(count: int = 60) -> list[Recorded]:
    """Packable, so that compressed chunks hold several; log times out of order."""
    generator = np.random.default_rng(7)
    return [
        Recorded(
            f"/{'ab'[row % 2]}",
            IMU,
            1_000_000_000 + int(generator.integers(0, 10**9)),
            b"\x00\x01\x00\x00" + generator.bytes(40) + b"." * int(generator.integers(0, 300)),
        )
        for row in range(count)
    ]


def _content(path: Path) -> list[tuple[str, int, bytes]]:
    """Topic, log time and bytes in the order of the file, by the mcap library."""
    with path.open("rb") as file:
        read = NonSeekingReader(file).iter_messages(log_time_order=False)
        return [(channel.topic, message.log_time, bytes(message.data)) for _schema, channel, message in read]


def _expected(messages: Sequence[Recorded]) -> list[tuple[str, int, bytes]]:
    return [(message.topic, message.log_time_ns, message.payload) for message in messages]


def _whole_by_mcap(path: Path) -> list[Message]:
    """What the mcap library gives before it gives up."""
    found = []
    with path.open("rb") as file:
        try:
            for _schema, _channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                found.append(message)
        except Exception:  # EndOfFile, RecordLengthLimitExceeded, zstd …: the file is cut
            return found
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_cut_anywhere_keeps_a_prefix_of_its_messages_and_every_whole_chunk(tmp_path: Path, kind: str) -> None:
    messages = _messages()
    content = write_mcap(tmp_path / "whole.mcap", messages, chunk_size=2000, **KINDS[kind]).read_bytes()
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    kept_before = 0
    for size in range(40, len(content), 401):
        cut.write_bytes(content[:size])
        recovery = recover(cut, out)
        kept = _content(out)
        assert kept == _expected(messages)[: len(kept)]
        assert len(kept) == recovery.messages == sum(recovery.topics.values())
        assert len(kept) >= max(kept_before, len(_whole_by_mcap(cut)))
        assert cut.read_bytes() == content[:size]
        kept_before = len(kept)
        if kept:
            assert recovery.last_ns == max(time_ns for _topic, time_ns, _payload in kept)
    assert kept_before == len(messages)


@pytest.mark.parametrize("kind", ["plain", "unchunked"])
def test_of_what_is_not_compressed_every_complete_message_is_kept(tmp_path: Path, kind: str) -> None:
    messages = _messages()
    content = write_mcap(tmp_path / "whole.mcap", messages, chunk_size=2000, **KINDS[kind]).read_bytes()
    stops = [content.index(message.payload) + len(message.payload) for message in messages]
    for size in range(stops[0], stops[-1], 409):
        (tmp_path / "cut.mcap").write_bytes(content[:size])
        assert recover(tmp_path / "cut.mcap", tmp_path / "out.mcap").messages == sum(stop <= size for stop in stops)


@pytest.mark.parametrize("compression", ["lz4", "zstd"])
def test_of_a_packed_chunk_that_was_cut_what_unpacks_is_kept(tmp_path: Path, compression: str) -> None:
    """One chunk of 4 MB is all there is, and half of it is gone: no whole chunk, yet messages."""
    generator = np.random.default_rng(1)
    messages = [Recorded("/a", IMU, row, b"\x00\x01\x00\x00" + generator.bytes(40_000)) for row in range(100)]
    packing = {"lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}[compression]
    path = write_mcap(tmp_path / "whole.mcap", messages, chunk_size=100 << 20, compression=packing)
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2])
    assert len(_whole_by_mcap(path)) == 0
    recovery = recover(path, tmp_path / "out.mcap")
    assert 40 <= recovery.messages <= 50
    assert _content(tmp_path / "out.mcap") == _expected(messages)[: recovery.messages]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_recovered_is_indexed_and_chunked_and_rosbags_reads_it(tmp_path: Path, kind: str) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "cut.mcap", messages, chunk_size=2000, **KINDS[kind])
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(CutBagError) as caught:
        open_bag(path)
    recovery, out = recover(path, tmp_path / "out.mcap"), tmp_path / "out.mcap"
    assert caught.value.code == recovery.finding.code == "BAG-010"
    with open_bag(out) as bag, Reader(out) as reader, out.open("rb") as file:
        assert bag.is_indexed
        assert {topic.name: topic.count for topic in bag.topics} == recovery.topics
        assert {topic.schema for topic in bag.topics} == {"".join(str(c.msgdef.data) for c in reader.connections[:1])}
        assert reader.message_count == recovery.messages
        summary = SeekingReader(file).get_summary()
        assert summary is not None
        assert summary.chunk_indexes


def test_attachments_metadata_sequence_and_publish_time_are_kept(tmp_path: Path) -> None:
    path, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2", library="tests")
        writer.add_attachment(5, 6, "calibration.yaml", "text/yaml", b"stone_calibration: 1")
        writer.add_metadata("robot", {"name": "m0", "plate": "é"})
        schema = writer.register_schema(IMU, "ros2msg", b"uint8 nothing")
        channel = writer.register_channel("/a", "cdr", schema, {"offered_qos_profiles": "- depth: 5"})
        writer.add_message(channel, 10, b"\x00\x01\x00\x00", publish_time=9, sequence=77)
        writer.finish()
    path.write_bytes(path.read_bytes()[:-20])
    assert recover(path, out).lost == "Only the index is lost."
    with out.open("rb") as file:
        reader = SeekingReader(file)
        assert reader.get_header().profile == "ros2"
        (attachment,) = reader.iter_attachments()
        assert (attachment.name, attachment.media_type, attachment.data) == (
            "calibration.yaml",
            "text/yaml",
            b"stone_calibration: 1",
        )
        assert (attachment.create_time, attachment.log_time) == (5, 6)
        assert [(metadata.name, metadata.metadata) for metadata in reader.iter_metadata()] == [
            ("robot", {"name": "m0", "plate": "é"})
        ]
        ((_schema, kept, message),) = reader.iter_messages()
        assert kept.metadata == {"offered_qos_profiles": "- depth: 5"}
        assert (message.log_time, message.publish_time, message.sequence) == (10, 9, 77)


def test_a_chunk_that_fails_its_checksum_is_left_out_and_said(tmp_path: Path) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "damaged.mcap", messages, chunk_size=2000, compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    content[content.index(messages[30].payload) + 20] ^= 1
    path.write_bytes(content)
    recovery = recover(path, tmp_path / "out.mcap")
    kept = _content(tmp_path / "out.mcap")
    assert messages[30].payload not in [payload for _topic, _time, payload in kept]
    assert len(messages) - 20 < len(kept) < len(messages)
    assert "(BAG-016)" in recovery.lost


def test_a_file_that_ends_in_zeros_is_cut_where_they_begin(tmp_path: Path) -> None:
    """What a power cut leaves of a file whose blocks were allocated and never written."""
    messages = _messages()
    content = write_mcap(tmp_path / "cut.mcap", messages, chunk_size=2000).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(content) * 2 // 3])
    expected = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap").messages
    with (tmp_path / "cut.mcap").open("r+b") as file:
        file.truncate(100_000)
    recovery = recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")
    assert 0 < expected - 20 <= recovery.messages <= expected
    assert f"cut off at byte {recovery.read_bytes} of 100000" in recovery.finding.message


def test_a_split_recording_is_recovered_into_one_file(tmp_path: Path) -> None:
    messages, folder = _messages(), tmp_path / "run"
    folder.mkdir()
    for part in range(3):
        write_mcap(folder / f"run_{part}.mcap", messages[20 * part : 20 * part + 20], chunk_size=1000)
    last = folder / "run_2.mcap"
    last.write_bytes(last.read_bytes()[:1500])
    with pytest.raises(CutBagError):
        open_bag(folder)
    recovery = recover(folder, tmp_path / "out.mcap")
    kept = _content(tmp_path / "out.mcap")
    assert 40 <= len(kept) == recovery.messages < 60
    assert kept == _expected(messages)[: len(kept)]
    assert "run_2.mcap: the incomplete part of the last" in recovery.lost
    with open_bag(tmp_path / "out.mcap") as bag:
        assert [topic.name for topic in bag.topics] == ["/a", "/b"]


def test_a_database_is_recovered_as_well_and_the_original_is_never_the_target(tmp_path: Path) -> None:
    messages = sorted(_messages(), key=lambda message: message.log_time_ns)
    recovery = recover(write_db3(tmp_path / "run.db3", messages), tmp_path / "out.mcap")
    assert _content(tmp_path / "out.mcap") == _expected(messages)
    assert (recovery.lost, recovery.finding.severity) == ("Only the index is lost.", "info")
    path = write_mcap(tmp_path / "run.mcap", _messages())
    before = path.read_bytes()
    (tmp_path / "alias.mcap").symlink_to(path)
    for out in (path, tmp_path / "alias.mcap"):
        with refused_as("BAG-026"):
            recover(path, out)
    assert path.read_bytes() == before


KILLED = """
import os, signal, sys
from pathlib import Path
from stone_recordings.bags.mcap.copy import Copy
from stone_recordings.bags.mcap.records import MAGIC
from stone_recordings.bags.recovery.recovery import recover
write, limit = Copy.write, int(sys.argv[3])
def dying(copy, *message):
    if copy.messages == limit:
        os.kill(os.getpid(), signal.SIGKILL)
    write(copy, *message)
Copy.write = dying
recover(Path(sys.argv[1]), Path(sys.argv[2]))
"""


@pytest.mark.parametrize("has_earlier", [False, True])
def test_a_recovery_that_is_killed_leaves_no_half_file(tmp_path: Path, has_earlier: bool) -> None:
    path, out = write_mcap(tmp_path / "run.mcap", _messages(), chunk_size=500), tmp_path / "out" / "out.mcap"
    out.parent.mkdir()
    if has_earlier:
        out.write_bytes(b"of an earlier run")
    command = [sys.executable, "-c", KILLED, str(path), str(out), "37"]
    done = subprocess.run(command, cwd=ROOT, check=False, capture_output=True, timeout=300)
    assert done.returncode == -signal.SIGKILL
    assert (out.read_bytes() == b"of an earlier run") if has_earlier else not out.exists()
    assert recover(path, out).messages == 60
    assert [entry.name for entry in out.parent.iterdir()] == ["out.mcap"]


CHUNKED = ("plain", "lz4", "zstd")
MAGIC_BYTES, PREFIX_BYTES = 8, 9
HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 3, 4, 5, 6, 7
LENGTHS = (0, 5, 300, 2**63)
COUNT = 240

Content = list[tuple[str, int, bytes]]


NOISE = np.random.default_rng(7)
MANY = tuple(
    Recorded(
        f"/{'abc'[row % 3]}",
        IMU,
        1_000_000_000 + 1_000 * row,
        b"\x00\x01\x00\x00" + NOISE.bytes(40) + b"." * int(NOISE.integers(0, 300)),
    )
    for row in range(COUNT)
)


@cache
def _whole(kind: str) -> bytes:
    """A file of `MANY`: of chunks, or without."""
    with TemporaryDirectory() as folder:
        return write_mcap(Path(folder) / "run.mcap", MANY, chunk_size=4000, **KINDS[kind]).read_bytes()


def _places(content: bytes, opcode: int) -> list[int]:
    """Where the records of the file itself begin that have this opcode."""
    places, at = [], MAGIC_BYTES
    while at + PREFIX_BYTES <= len(content) - MAGIC_BYTES:
        found, length = unpack_from("<BQ", content, at)
        places += [at] if found == opcode else []
        at += PREFIX_BYTES + length
    return places


def _recovered(path: Path, content: bytes) -> tuple[Recovery, Content]:
    path.write_bytes(content)
    out = path.with_name("out.mcap")
    recovery = recover(path, out)
    return recovery, _content(out)


def _with_length(content: bytes, at: int, length: int) -> bytes:
    return content[: at + 1] + pack("<Q", length) + content[at + PREFIX_BYTES :]


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("kind", CHUNKED)
def test_a_damaged_header_costs_no_message(tmp_path: Path, kind: str, length: int) -> None:
    whole = _whole(kind)
    recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, MAGIC_BYTES, length))
    assert kept == _expected(MANY)
    assert f"{COUNT} of {COUNT} messages of 3 topics" in recovery.finding.message
    with (tmp_path / "out.mcap").open("rb") as file:
        summary = SeekingReader(file).get_summary()
        assert summary is not None
        assert {index.compression for index in summary.chunk_indexes} == {kind.replace("plain", "")}


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("opcode", [CHUNK, MESSAGE_INDEX])
@pytest.mark.parametrize("row", [0, 7])
def test_a_chunk_or_an_index_whose_length_is_damaged_costs_no_message(tmp_path, row, opcode, length):
    """The summary's index says where the chunk ends, and where the next one begins."""
    whole = _whole("plain")
    _recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, _places(whole, opcode)[row], length))
    assert kept == _expected(MANY)


@pytest.mark.parametrize("kind", CHUNKED)
@pytest.mark.parametrize("field", [9, 17, 25, 37, 41, 45, 49])
def test_a_chunk_whose_own_head_is_damaged_is_read_as_the_summary_describes_it(tmp_path, kind, field):
    """Its times, its size, the name of its compression, the lengths of either; its checksum says that it is whole."""
    whole = _whole(kind)
    at = _places(whole, CHUNK)[3] + min(field, 9 + 32 + len(kind.replace("plain", "")))
    _recovery, kept = _recovered(tmp_path / "run.mcap", whole[:at] + bytes([whole[at] ^ 0x41]) + whole[at + 1 :])
    assert kept == _expected(MANY)


@pytest.mark.parametrize("kind", CHUNKED)
@pytest.mark.parametrize("size", [1, 8, 30])
@pytest.mark.parametrize("zeros", [0, 5000])
def test_a_file_whose_first_bytes_are_gone_is_known_by_its_last(tmp_path, kind, size, zeros):
    path, whole = tmp_path / "run.mcap", _whole(kind)
    path.write_bytes(bytes(size) + whole[size:] + bytes(zeros))
    with open_bag(path) as bag:
        assert sum(topic.count for topic in bag.topics) == COUNT
        assert [found.code for found in bag.findings] == ["BAG-033", *["BAG-032"] * bool(zeros)]
        assert bytes(bag.message("/a", 60).payload) == MANY[180].payload
    recovery, kept = _recovered(path, path.read_bytes())
    assert kept == _expected(MANY)
    assert (recovery.finding.severity == "info") == (size <= MAGIC_BYTES)
    with open_bag(tmp_path / "out.mcap") as bag:
        assert bag.findings == ()


@pytest.mark.parametrize("kind", CHUNKED)
def test_a_file_whose_first_chunk_is_gone_is_refused_with_the_way_out_and_keeps_the_others(tmp_path, kind):
    path, whole = tmp_path / "run.mcap", _whole(kind)
    path.write_bytes(bytes(700) + whole[700:])
    with pytest.raises(MalformedBagError):
        open_bag(path)
    recovery, kept = _recovered(path, path.read_bytes())
    assert kept == _expected(MANY)[-len(kept) :]
    assert COUNT - 20 < len(kept) < COUNT
    assert "stone recover" not in recovery.lost
    with open_bag(tmp_path / "out.mcap") as bag:
        assert bag.findings == ()


@pytest.mark.whole
@pytest.mark.parametrize("kind", CHUNKED)
def test_wherever_a_few_bytes_are_wrong_only_the_chunk_they_lie_in_is_lost(tmp_path: Path, kind: str) -> None:
    whole = _whole(kind)
    data_stop = unpack_from("<Q", whole, len(whole) - MAGIC_BYTES - 20)[0] - PREFIX_BYTES - 4
    chunks = [*_places(whole, CHUNK), data_stop]
    generator = np.random.default_rng(5)
    for _ in range(60):
        at, size = int(generator.integers(0, data_stop - 9)), int(generator.integers(1, 9))
        damaged = whole[:at] + generator.bytes(size) + whole[at + size :]
        _recovery, kept = _recovered(tmp_path / "run.mcap", damaged)
        hit = sum(start < at + size and at < stop for start, stop in pairwise(chunks))
        assert [one for one in _expected(MANY) if one in kept] == kept
        assert len(kept) >= COUNT - 24 * hit


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("row", [0, 100, COUNT - 1])
def test_of_a_file_without_chunks_only_the_message_is_lost_whose_length_is_damaged(tmp_path, row, length):
    """Nothing says where its messages lie: they are found again by their channels and times, as the summary tells."""
    whole = _whole("unchunked")
    recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, _places(whole, MESSAGE)[row], length))
    assert kept == _expected(MANY[:row] + MANY[row + 1 :])
    assert f"{COUNT - 1} of {COUNT} messages" in recovery.finding.message


@pytest.mark.parametrize("opcode", [HEADER, SCHEMA, CHANNEL])
@pytest.mark.parametrize("length", LENGTHS)
def test_of_a_file_without_chunks_damaged_definitions_cost_no_message(tmp_path: Path, opcode: int, length: int) -> None:
    whole = _whole("unchunked")
    _recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, _places(whole, opcode)[0], length))
    assert kept == _expected(MANY)


def test_a_summary_that_lies_about_chunks_takes_nothing_from_what_the_data_says(tmp_path: Path) -> None:
    whole = bytearray(_whole("plain"))
    summary_at = unpack_from("<Q", whole, len(whole) - MAGIC_BYTES - 20)[0]
    generator = np.random.default_rng(11)
    for _ in range(40):
        lying = bytearray(whole)
        for _ in range(20):
            lying[int(generator.integers(summary_at, len(whole) - 40))] = int(generator.integers(0, 256))
        _recovery, kept = _recovered(tmp_path / "run.mcap", bytes(lying))
        assert kept == _expected(MANY)


@pytest.mark.parametrize("kind", CHUNKED)
@pytest.mark.parametrize("zeros", [1, 4096, 3 << 20])
def test_a_whole_file_with_zeros_behind_it_is_not_cut_off(tmp_path: Path, kind: str, zeros: int) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(_whole(kind) + bytes(zeros))
    with open_bag(path) as bag:
        assert bag.is_indexed
        assert sum(topic.count for topic in bag.topics) == COUNT
        assert [(found.code, found.severity) for found in bag.findings] == [("BAG-032", "info")]
        assert bytes(bag.message("/a", 0).payload) == MANY[0].payload
    recovery, kept = _recovered(path, path.read_bytes())
    assert kept == _expected(MANY)
    assert recovery.lost == "Only the index is lost."
    assert recovery.finding.severity == "info"


@pytest.mark.whole
def test_a_large_file_is_recovered_in_little_memory(tmp_path: Path) -> None:
    """120 MB; a window of the mapped original and one chunk of the copy are in memory at a time."""
    payload = b"\x00\x01\x00\x00" + np.random.default_rng(0).bytes(2_000_000)
    messages = [Recorded("/a", "sensor_msgs/msg/Imu", row, payload) for row in range(60)]
    path = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4 << 20)
    count, growth_bytes = growth_of(path, tmp_path / "out.mcap")
    assert count == "60"
    assert growth_bytes < GROWTH_LIMIT_BYTES


@pytest.mark.whole
@pytest.mark.parametrize("compression", [b"lz4", b"zstd"])
def test_a_chunk_without_end_costs_no_more_than_its_pieces(tmp_path: Path, compression: bytes) -> None:
    """The last whole messages of a chunk that claims all of a file of 300 MB, which is a hole."""
    packed = {b"lz4": lz4.frame.compress, b"zstd": zstandard.compress}[compression](bytes(1000))
    head = struct.pack("<BQQQQII", 6, 1 << 40, 0, 0, 1 << 40, 0, len(compression)) + compression
    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + head + struct.pack("<Q", 1 << 40) + packed)
    os.truncate(path, 300_000_000)
    count, growth_bytes = growth_of(path, tmp_path / "out.mcap")
    assert count == "0"
    assert growth_bytes < GROWTH_LIMIT_BYTES
