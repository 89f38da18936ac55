"""`stone recover` makes an MCAP file of whatever is whole of a ROS 1 bag; a bag that was cut is read without it."""

from pathlib import Path

import pytest

from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.errors import CutBagError, MalformedBagError
from stone_recordings.bags.recovery.recovery import recover
from testing.worlds.ros1_bags import Ros1Compression, as_ros1, unclosed

CHUNK_BYTES = 100_000


def _messages(path: Path) -> dict[str, list[bytes]]:
    with open_bag(path) as bag:
        return {topic.name: [bytes(m.payload) for m in bag.messages(topic.name)] for topic in bag.topics if topic.count}


def test_a_whole_bag_becomes_the_mcap_file_that_it_was_made_of(drive: Path, tmp_path: Path) -> None:
    bag = as_ros1(drive, tmp_path / "run.bag", "lz4")
    recovery = recover(bag, tmp_path / "out.mcap")
    assert (recovery.finding.severity, recovery.lost) == ("info", "Nothing is lost but the index.")
    assert _messages(tmp_path / "out.mcap") == _messages(drive)
    with open_bag(tmp_path / "out.mcap") as found, open_bag(bag) as expected:
        assert found.topics == expected.topics


@pytest.mark.parametrize("compression", ["none", "bz2", "lz4"])
@pytest.mark.parametrize("is_closed", [True, False])
def test_a_bag_cut_anywhere_keeps_a_prefix_of_its_messages(
    drive: Path, tmp_path: Path, compression: Ros1Compression, is_closed: bool
) -> None:
    """Both as it is opened and as it is recovered; a closed bag that was cut by copying, too.

    Catches alone a message that is taken from a chunk which ends in the middle of it.
    """
    whole, expected = as_ros1(drive, tmp_path / "whole.bag", compression, CHUNK_BYTES), _messages(drive)
    content = (whole if is_closed else unclosed(whole, tmp_path / "open.bag")).read_bytes()
    cut, kept_before = tmp_path / "cut.bag", 0
    for size in range(300_000, len(content), len(content) // 4):
        cut.write_bytes(content[:size])
        kept = _messages(cut)
        for topic, payloads in kept.items():
            assert payloads == expected[topic][: len(payloads)]
        count = sum(len(payloads) for payloads in kept.values())
        assert count >= kept_before
        kept_before = count
        recovery = recover(cut, tmp_path / "out.mcap")
        assert recovery.finding.severity == ("info" if kept == expected and is_closed else "warning")
        assert recovery.read_bytes <= recovery.total_bytes == size
        assert _messages(tmp_path / "out.mcap") == kept
    assert kept_before > sum(map(len, expected.values())) // 2


def test_of_a_plain_chunk_that_the_recorder_died_in_every_whole_message_is_kept(drive: Path, tmp_path: Path) -> None:
    content = unclosed(as_ros1(drive, tmp_path / "whole.bag", chunk_bytes=1 << 30), tmp_path / "open.bag").read_bytes()
    cut = tmp_path / "cut.bag"
    cut.write_bytes(content[: len(content) // 2])
    with open_bag(cut) as bag, open_bag(drive) as whole:
        counts = [sum(topic.count for topic in one.topics) for one in (bag, whole)]
        assert counts[0] > 0.3 * counts[1]
        (finding,) = bag.findings
        assert (finding.code, finding.severity) == ("BAG-010", "warning")
        assert f"{counts[0]} messages up to byte" in finding.message


def test_a_chunk_that_does_not_inflate_costs_its_own_messages_and_is_said(drive: Path, tmp_path: Path) -> None:
    bag = as_ros1(drive, tmp_path / "run.bag", "lz4", CHUNK_BYTES)
    content = bytearray(bag.read_bytes())
    at = content.index(b"compression=lz4", len(content) // 2) + 2_000
    content[at : at + 64] = bytes(64)
    bag.write_bytes(content)
    with open_bag(bag) as opened:
        assert opened.is_indexed
        damaged = sum(len(reasons) for reasons in opened.damaged.values())
        assert {finding.code for finding in opened.damage_findings} == {"BAG-016"}
    recovery = recover(bag, tmp_path / "out.mcap")
    with open_bag(drive) as whole:
        assert recovery.messages == sum(topic.count for topic in whole.topics) - damaged
    assert damaged > 0
    assert "does not decompress" in recovery.lost


def test_a_record_that_is_none_is_passed_over_to_the_next_chunk_that_the_index_knows(
    drive: Path, tmp_path: Path
) -> None:
    bag = as_ros1(drive, tmp_path / "run.bag", "lz4", CHUNK_BYTES)
    content = bytearray(bag.read_bytes())
    at = content.index(b"compression=lz4", len(content) // 2)
    content[at : at + 11] = b"COMPRESSION"
    content[at - 20 : at - 4] = bytes(16)
    bag.write_bytes(content)
    with pytest.raises(MalformedBagError, match="are not complete records"):
        open_bag(bag)
    recovery = recover(bag, tmp_path / "out.mcap")
    with open_bag(drive) as whole:
        assert 0.5 < recovery.messages / sum(topic.count for topic in whole.topics) < 1
    assert "are not complete records" in recovery.lost


def test_a_bag_without_a_whole_message_is_refused(drive: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.bag"
    cut.write_bytes(as_ros1(drive, tmp_path / "run.bag").read_bytes()[:4_200])
    with pytest.raises(CutBagError, match="it has no complete message"):
        recover(cut, tmp_path / "out.mcap")
