"""Of a recording that is damaged early, but whole at its end, everything is recovered that the damage did not hit."""

from itertools import pairwise
from pathlib import Path
from struct import pack, unpack_from

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.writer import CompressionType

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import MalformedBagError
from stone_recordings.bags.recovery.recovery import Recovery, recover
from tests.stone_recordings.writing import Recorded, write_mcap

IMU = "sensor_msgs/msg/Imu"
CHUNKED = {
    "plain": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
}
MAGIC_BYTES, PREFIX_BYTES = 8, 9
HEADER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX = 1, 3, 4, 5, 6, 7
LENGTHS = (0, 1, 5, 300, 2**31, 2**63)
COUNT = 639

Content = list[tuple[str, int, bytes]]


def _messages(count: int = COUNT) -> list[Recorded]:
    generator = np.random.default_rng(7)
    return [
        Recorded(
            f"/{'abc'[row % 3]}",
            IMU,
            1_000_000_000 + 1_000 * row,
            b"\x00\x01\x00\x00" + generator.bytes(40) + b"." * int(generator.integers(0, 300)),
        )
        for row in range(count)
    ]


def _expected(messages: list[Recorded]) -> Content:
    return [(message.topic, message.log_time_ns, message.payload) for message in messages]


def _content(path: Path) -> Content:
    """By the mcap library."""
    with path.open("rb") as file:
        read = NonSeekingReader(file).iter_messages(log_time_order=False)
        return [(channel.topic, message.log_time, bytes(message.data)) for _schema, channel, message in read]


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
    messages = _messages()
    whole = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind]).read_bytes()
    recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, MAGIC_BYTES, length))
    assert kept == _expected(messages)
    assert f"{COUNT} of {COUNT} messages of 3 topics" in recovery.finding.message
    with (tmp_path / "out.mcap").open("rb") as file:
        summary = SeekingReader(file).get_summary()
        assert summary is not None
        assert {index.compression for index in summary.chunk_indexes} == {kind.replace("plain", "")}


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("opcode", [CHUNK, MESSAGE_INDEX])
@pytest.mark.parametrize("row", [0, 7])
def test_a_chunk_or_an_index_whose_length_is_damaged_costs_no_message(
    tmp_path: Path, row: int, opcode: int, length: int
) -> None:
    """The summary's index says where the chunk ends, and where the next one begins."""
    messages = _messages()
    whole = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000).read_bytes()
    _recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, _places(whole, opcode)[row], length))
    assert kept == _expected(messages)


@pytest.mark.parametrize("kind", CHUNKED)
@pytest.mark.parametrize("field", [9, 17, 25, 37, 41, 45, 49])
def test_a_chunk_whose_own_head_is_damaged_is_read_as_the_summary_describes_it(
    tmp_path: Path, kind: str, field: int
) -> None:
    """Its times, its size, the name of its compression, the lengths of either; its checksum says that it is whole."""
    messages = _messages()
    whole = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind]).read_bytes()
    at = _places(whole, CHUNK)[3] + min(field, 9 + 32 + len(kind.replace("plain", "")))
    _recovery, kept = _recovered(tmp_path / "run.mcap", whole[:at] + bytes([whole[at] ^ 0x41]) + whole[at + 1 :])
    assert kept == _expected(messages)


@pytest.mark.parametrize("kind", CHUNKED)
@pytest.mark.parametrize("size", [1, 8, 30])
@pytest.mark.parametrize("zeros", [0, 5000])
def test_a_file_whose_first_bytes_are_gone_is_known_by_its_last(
    tmp_path: Path, kind: str, size: int, zeros: int
) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind])
    whole = path.read_bytes()
    path.write_bytes(bytes(size) + whole[size:] + bytes(zeros))
    with open_bag(path) as bag:
        assert sum(topic.count for topic in bag.topics) == COUNT
        assert [found.code for found in bag.findings] == ["BAG-033", *["BAG-032"] * bool(zeros)]
        assert bytes(bag.message("/a", 200).payload) == messages[600].payload
    recovery, kept = _recovered(path, path.read_bytes())
    assert kept == _expected(messages)
    assert (recovery.finding.severity == "info") == (size <= MAGIC_BYTES)
    with open_bag(tmp_path / "out.mcap") as bag:
        assert bag.findings == ()


@pytest.mark.parametrize("kind", CHUNKED)
def test_a_file_whose_first_chunk_is_gone_is_refused_with_the_way_out_and_keeps_the_others(
    tmp_path: Path, kind: str
) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind])
    whole = path.read_bytes()
    path.write_bytes(bytes(700) + whole[700:])
    with pytest.raises(MalformedBagError, match="stone recover"):
        open_bag(path)
    recovery, kept = _recovered(path, path.read_bytes())
    assert kept == _expected(messages)[-len(kept) :]
    assert COUNT - 20 < len(kept) < COUNT
    assert "stone recover" not in recovery.lost
    with open_bag(tmp_path / "out.mcap") as bag:
        assert bag.findings == ()


@pytest.mark.parametrize("kind", CHUNKED)
def test_wherever_a_few_bytes_are_wrong_only_the_chunk_they_lie_in_is_lost(tmp_path: Path, kind: str) -> None:
    messages = _messages(200)
    whole = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind]).read_bytes()
    data_stop = unpack_from("<Q", whole, len(whole) - MAGIC_BYTES - 20)[0] - PREFIX_BYTES - 4
    chunks = [*_places(whole, CHUNK), data_stop]
    generator = np.random.default_rng(5)
    for _ in range(120):
        at, size = int(generator.integers(0, data_stop - 9)), int(generator.integers(1, 9))
        damaged = whole[:at] + generator.bytes(size) + whole[at + size :]
        _recovery, kept = _recovered(tmp_path / "run.mcap", damaged)
        hit = sum(start < at + size and at < stop for start, stop in pairwise(chunks))
        assert [one for one in _expected(messages) if one in kept] == kept
        assert len(kept) >= len(messages) - 24 * hit


def test_where_the_chunk_that_defines_the_channels_is_lost_the_summary_defines_them(tmp_path: Path) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, compression=CompressionType.NONE)
    content = bytearray(path.read_bytes())
    content[content.index(messages[0].payload) + 20] ^= 1
    recovery, kept = _recovered(path, bytes(content))
    assert kept == _expected(messages)[-len(kept) :]
    assert COUNT - 30 < len(kept) < COUNT
    assert f"is damaged: {len(kept)} of {COUNT} messages of 3 topics" in recovery.finding.message


@pytest.mark.parametrize("kind", CHUNKED)
def test_bytes_that_are_overwritten_cost_the_chunks_they_lie_in(tmp_path: Path, kind: str) -> None:
    messages = _messages()
    whole = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind]).read_bytes()
    chunks = _places(whole, CHUNK)
    first, last = chunks[3] + 100, chunks[5] - 20
    garbage = np.random.default_rng(3).bytes(last - first)
    recovery, kept = _recovered(tmp_path / "run.mcap", whole[:first] + garbage + whole[last:])
    for start, stop in ((MAGIC_BYTES, chunks[3]), (chunks[5], len(whole))):
        inside = {payload for payload in (m.payload for m in messages) if payload in whole[start:stop]}
        assert inside <= {payload for _topic, _time, payload in kept}
    assert [one for one in _expected(messages) if one in kept] == kept
    assert recovery.lost.startswith("Lost: ")


@pytest.mark.parametrize("length", LENGTHS)
@pytest.mark.parametrize("row", [0, 300, COUNT - 1])
def test_of_a_file_without_chunks_only_the_message_is_lost_whose_length_is_damaged(
    tmp_path: Path, row: int, length: int
) -> None:
    """Nothing says where its messages lie: they are found again by their channels and times, as the summary tells."""
    messages = _messages()
    whole = write_mcap(tmp_path / "run.mcap", messages, use_chunking=False).read_bytes()
    recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, _places(whole, MESSAGE)[row], length))
    assert kept == _expected(messages[:row] + messages[row + 1 :])
    assert f"{COUNT - 1} of {COUNT} messages" in recovery.finding.message


@pytest.mark.parametrize("opcode", [HEADER, SCHEMA, CHANNEL])
@pytest.mark.parametrize("length", LENGTHS)
def test_of_a_file_without_chunks_damaged_definitions_cost_no_message(tmp_path: Path, opcode: int, length: int) -> None:
    messages = _messages()
    whole = write_mcap(tmp_path / "run.mcap", messages, use_chunking=False).read_bytes()
    _recovery, kept = _recovered(tmp_path / "run.mcap", _with_length(whole, _places(whole, opcode)[0], length))
    assert kept == _expected(messages)


def test_a_summary_that_lies_about_chunks_takes_nothing_from_what_the_data_says(tmp_path: Path) -> None:
    messages = _messages()
    whole = bytearray(write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000).read_bytes())
    summary_at = unpack_from("<Q", whole, len(whole) - MAGIC_BYTES - 20)[0]
    generator = np.random.default_rng(11)
    for _ in range(60):
        lying = bytearray(whole)
        for _ in range(20):
            lying[int(generator.integers(summary_at, len(whole) - 40))] = int(generator.integers(0, 256))
        _recovery, kept = _recovered(tmp_path / "run.mcap", bytes(lying))
        assert kept == _expected(messages)


@pytest.mark.parametrize("kind", CHUNKED)
@pytest.mark.parametrize("zeros", [1, 4096, 3 << 20])
def test_a_whole_file_with_zeros_behind_it_is_not_cut_off(tmp_path: Path, kind: str, zeros: int) -> None:
    messages = _messages()
    path = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4000, **CHUNKED[kind])
    path.write_bytes(path.read_bytes() + bytes(zeros))
    with open_bag(path) as bag:
        assert bag.is_indexed
        assert sum(topic.count for topic in bag.topics) == COUNT
        assert [(found.code, found.severity) for found in bag.findings] == [("BAG-032", "info")]
        assert bytes(bag.message("/a", 0).payload) == messages[0].payload
    recovery, kept = _recovered(path, path.read_bytes())
    assert kept == _expected(messages)
    assert recovery.lost == "Nothing is lost but the index."
    assert recovery.finding.severity == "info"
