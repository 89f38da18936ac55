"""A damaged chunk costs the messages in it: they are told, passed over, and all others are read."""

from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from stone_files.joined_file import JoinedMember
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import ChecksumError, IngestError
from stone_recordings.bags.joined.moved_bag import MovedBag
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
def test_a_checked_scan_passes_damage_over_that_nobody_asked_for_and_tells_it_then(
    tmp_path: Path, compression: CompressionType
) -> None:
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


def test_a_sound_recording_has_no_damage(tmp_path: Path) -> None:
    with open_bag(recorded(tmp_path / "run.mcap")) as bag:
        assert bag.damaged == {}
        assert bag.damage_findings == ()
        assert indices(bag, "/a") == list(range(COUNT))


def test_who_does_not_ask_is_refused(tmp_path: Path) -> None:
    path = recorded(tmp_path / "run.mcap", compression=CompressionType.NONE)
    bad_chunk(path)
    with open_bag(path) as bag, pytest.raises(ChecksumError):
        [bag.message("/a", index) for index in range(COUNT)]


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
