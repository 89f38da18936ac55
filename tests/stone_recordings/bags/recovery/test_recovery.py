"""What is whole of a recording that was cut off is kept, what is lost is said, and the original stays as it was."""

import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, SeekingReader
from mcap.records import Message
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import Reader

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import CutBagError, RecoveryTargetError
from stone_recordings.bags.recovery.recovery import recover
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


def _expected(messages: list[Recorded]) -> list[tuple[str, int, bytes]]:
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
    with pytest.raises(CutBagError, match=r"stone recover cut\.mcap -o") as caught:
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


def test_the_same_file_is_recovered_to_the_same_bytes(tmp_path: Path) -> None:
    content = write_mcap(tmp_path / "cut.mcap", _messages(), chunk_size=2000).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[:3000])
    recover(tmp_path / "cut.mcap", tmp_path / "first.mcap")
    recover(tmp_path / "cut.mcap", tmp_path / "second.mcap")
    assert (tmp_path / "first.mcap").read_bytes() == (tmp_path / "second.mcap").read_bytes()


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
    assert recover(path, out).lost == "Nothing is lost but the index."
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
    assert "CRC-32 is" in recovery.lost
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
    with pytest.raises(CutBagError, match=r"run_2\.mcap was cut off"):
        open_bag(folder)
    recovery = recover(folder, tmp_path / "out.mcap")
    kept = _content(tmp_path / "out.mcap")
    assert 40 <= len(kept) == recovery.messages < 60
    assert kept == _expected(messages)[: len(kept)]
    assert "run_2.mcap: the incomplete part of the last" in recovery.lost
    with open_bag(tmp_path / "out.mcap") as bag:
        assert [topic.name for topic in bag.topics] == ["/a", "/b"]


def test_a_database_is_recovered_into_a_file_as_well(tmp_path: Path) -> None:
    messages = sorted(_messages(), key=lambda message: message.log_time_ns)
    recovery = recover(write_db3(tmp_path / "run.db3", messages), tmp_path / "out.mcap")
    assert _content(tmp_path / "out.mcap") == _expected(messages)
    assert (recovery.lost, recovery.finding.severity) == ("Nothing is lost but the index.", "info")


def test_the_original_is_never_the_target(tmp_path: Path) -> None:
    path = write_mcap(tmp_path / "run.mcap", _messages())
    before = path.read_bytes()
    (tmp_path / "alias.mcap").symlink_to(path)
    for out in (path, tmp_path / "alias.mcap"):
        with pytest.raises(RecoveryTargetError, match="is the original") as caught:
            recover(path, out)
    assert caught.value.code == "BAG-026"
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
