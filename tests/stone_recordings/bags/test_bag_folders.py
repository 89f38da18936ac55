"""A folder is one recording, however it is split, listed or mislabelled, and leads nowhere else."""

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType

from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.errors import MalformedBagError, NotABagError
from stone_recordings.bags.members import MOST_MEMBERS, members_of
from stone_recordings.bags.private_folder import SMALL_BYTES
from stone_recordings.bags.split_store import AWAKE, SplitStore
from stone_recordings.report.inspection import inspect
from testing.refusals import refused_as
from tests.stone_recordings.databases import write_db3
from tests.stone_recordings.writing import Recorded, write_mcap

IMU = "sensor_msgs/msg/Imu"
WRITERS: dict[str, Callable[[Path, list[Recorded]], Path]] = {
    "mcap": lambda path, messages: write_mcap(path, messages, chunk_size=600, compression=CompressionType.LZ4),
    "db3": lambda path, messages: write_db3(path, messages),
}


def _messages(count: int = 60) -> list[Recorded]:
    """Log times with ties and, within a file, out of order."""
    generator = np.random.default_rng(11)
    return [
        Recorded(
            f"/{'abc'[row % 3]}", IMU, row // 4 + int(generator.integers(0, 3)), b"\x00\x01\x00\x00" + bytes([row]) * 90
        )
        for row in range(count)
    ]


def _split(folder: Path, suffix: str, parts: int = 3) -> list[Recorded]:
    """`parts` files; the last topic is only in the first of them."""
    folder.mkdir()
    messages = [message for row, message in enumerate(_messages()) if message.topic != "/c" or row < 20]
    size = len(messages) // parts
    for part in range(parts):
        stop = None if part == parts - 1 else size * (part + 1)
        WRITERS[suffix](folder / f"run_{part}.{suffix}", messages[size * part : stop])
    return messages


def _metadata(folder: Path, names: list[str], text: str = "") -> None:
    listed = "\n".join(f"    - {name}" for name in names)
    (folder / "metadata.yaml").write_text(
        f"rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  relative_file_paths:\n{listed}\n"
        f"  message_count: 999999999999\n{text}"
    )


def _read(bag: Bag) -> dict[str, list[tuple[int, bytes]]]:
    return {t.name: [(m.log_time_ns, bytes(m.payload)) for m in bag.messages(t.name)] for t in bag.topics}


def _expected(messages: list[Recorded]) -> dict[str, list[tuple[int, bytes]]]:
    """In log-time order; of equal times those of the earlier file and place first."""
    names = sorted({message.topic for message in messages})
    own = {name: [(m.log_time_ns, m.payload) for m in messages if m.topic == name] for name in names}
    return {name: sorted(pairs, key=lambda pair: pair[0]) for name, pairs in own.items()}


def _codes(bag: Bag) -> list[str]:
    return [finding.code for finding in bag.findings]


@pytest.mark.parametrize("suffix", WRITERS)
@pytest.mark.parametrize("has_metadata", [True, False])
def test_a_split_recording_is_read_as_one(tmp_path: Path, suffix: str, has_metadata: bool) -> None:
    messages = _split(tmp_path / "run", suffix)
    if has_metadata:
        _metadata(tmp_path / "run", [f"run_{part}.{suffix}" for part in range(3)])
    with open_bag(tmp_path / "run") as bag:
        assert isinstance(bag._store, SplitStore)
        assert _read(bag) == _expected(messages)
        assert {topic.name: topic.count for topic in bag.topics} == {n: len(p) for n, p in _expected(messages).items()}
        assert _codes(bag) == ([] if has_metadata else ["BAG-025"])
        for index in (7, 0, 19, 3):
            assert bytes(bag.message("/a", index).payload) == _expected(messages)["/a"][index][1]


@pytest.mark.parametrize("suffix", WRITERS)
def test_heads_of_a_split_recording_come_once_each_in_the_order_of_the_files(tmp_path: Path, suffix: str) -> None:
    messages = _split(tmp_path / "run", suffix)
    with open_bag(tmp_path / "run") as bag:
        heads = [(name, index, bytes(head)) for name, index, head in bag.heads(("/b", "/a", "/c"))]
    assert sorted((name, payload) for name, _index, payload in heads) == sorted((m.topic, m.payload) for m in messages)
    for name, index, payload in heads:
        assert _expected(messages)[name][index][1] == payload
    assert [payload for name, _, payload in heads if name == "/a"] == [m.payload for m in messages if m.topic == "/a"]


def test_the_tenth_file_follows_the_ninth(tmp_path: Path) -> None:
    _split(tmp_path / "run", "mcap", parts=12)
    assert [file.stem for file in members_of(tmp_path / "run").files] == [f"run_{part}" for part in range(12)]


@contextmanager
def _few_open_files(count: int) -> Iterator[None]:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (len(os.listdir("/proc/self/fd")) + count, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_open_files_and_memory_do_not_grow_with_the_number_of_files(tmp_path: Path) -> None:
    messages = _split(tmp_path / "run", "db3", parts=20)
    with _few_open_files(10), open_bag(tmp_path / "run") as bag:
        assert _read(bag) == _expected(messages)
        store = bag._store
        assert isinstance(store, SplitStore)
        awake = [part for part in store._parts if part._rows._connection is not None]  # type: ignore[attr-defined]
        assert len(awake) <= AWAKE


def test_a_missing_or_empty_file_is_an_error_and_the_others_are_read(tmp_path: Path) -> None:
    messages = _split(tmp_path / "run", "mcap")
    _metadata(tmp_path / "run", ["run_0.mcap", "run_1.mcap", "run_2.mcap", "run_3.mcap"])
    (tmp_path / "run" / "run_1.mcap").write_bytes(b"")
    (tmp_path / "run" / "run_2.mcap").unlink()
    with open_bag(tmp_path / "run") as bag:
        (finding,) = bag.findings
        assert (finding.code, finding.severity) == ("BAG-021", "error")
        assert "lists 4 files, 3 are missing or empty: run_1.mcap, run_2.mcap, run_3.mcap" in finding.message
        first = messages[: len(messages) // 3]
        assert _read(bag) == _expected(first)
    assert "BAG-021" in [each.code for each in inspect(tmp_path / "run").findings]
    (tmp_path / "run" / "run_0.mcap").unlink()
    with refused_as("BAG-019"):
        open_bag(tmp_path / "run")


def test_a_file_that_is_not_listed_is_left_out_and_said(tmp_path: Path) -> None:
    messages = _split(tmp_path / "run", "db3")
    _metadata(tmp_path / "run", ["run_0.db3", "run_1.db3", "run_2.db3"])
    write_mcap(tmp_path / "run" / "converted.mcap", messages)
    (tmp_path / "run" / "notes.txt").write_text("rain")
    with open_bag(tmp_path / "run") as bag:
        assert _read(bag) == _expected(messages)
        assert _codes(bag) == ["BAG-024"]
        assert "converted.mcap" in bag.findings[0].message


def test_files_of_two_kinds_or_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    messages = _split(tmp_path / "run", "db3")
    write_mcap(tmp_path / "run" / "converted.mcap", messages)
    with refused_as("BAG-019"):
        open_bag(tmp_path / "run")
    (tmp_path / "types").mkdir()
    write_mcap(tmp_path / "types" / "run_0.mcap", [Recorded("/a", IMU, 0, bytes(4))])
    write_mcap(tmp_path / "types" / "run_1.mcap", [Recorded("/a", "nav_msgs/msg/Odometry", 1, bytes(4))])
    with pytest.raises(MalformedBagError):
        open_bag(tmp_path / "types")


@pytest.mark.parametrize("listed", ["../outside.mcap", "/etc/hostname", "run/../../outside.mcap", "..", ".", '""'])
def test_a_list_leads_to_no_file_outside_its_folder(tmp_path: Path, listed: str) -> None:
    write_mcap(tmp_path / "outside.mcap", _messages())
    messages = _split(tmp_path / "run", "mcap")
    _metadata(tmp_path / "run", ["run_0.mcap", "run_1.mcap", "run_2.mcap", listed])
    with open_bag(tmp_path / "run") as bag:
        assert _codes(bag) == ["BAG-021"]
        assert _read(bag) == _expected(messages)


def test_old_lists_that_repeat_the_folder_are_understood(tmp_path: Path) -> None:
    messages = _split(tmp_path / "run", "db3")
    _metadata(tmp_path / "run", [f"run/run_{part}.db3" for part in range(3)] + ["run_0.db3"])
    with open_bag(tmp_path / "run") as bag:
        assert _read(bag) == _expected(messages)
        assert _codes(bag) == []


HOSTILE_LISTS = {
    "no yaml": "rosbag2_bagfile_information: [",
    "aliases": "a: &a [x,x,x,x,x,x,x,x,x]\nb: &b [*a,*a,*a,*a,*a,*a,*a,*a,*a]\nc: [*b,*b,*b,*b,*b,*b,*b,*b,*b]\n",
    "depth": "[" * 2000,
    "binary": "\x00\x01\x02",
    "size": "# " + "x" * 5_000_000,
    "a tag": "!!python/object/apply:os.system ['true']",
    "other keys": "? {a: b}\n: 1\n",
    "a scalar": "rosbag2_bagfile_information",
}


@pytest.mark.parametrize("kind", HOSTILE_LISTS)
def test_a_list_that_cannot_be_read_is_said_and_the_files_are_taken(tmp_path: Path, kind: str) -> None:
    messages = _split(tmp_path / "run", "mcap")
    (tmp_path / "run" / "metadata.yaml").write_text(HOSTILE_LISTS[kind])
    with open_bag(tmp_path / "run") as bag:
        assert _read(bag) == _expected(messages)
        assert [(finding.code, finding.severity) for finding in bag.findings] == [("BAG-023", "warning")]


def test_links_are_followed_to_files_and_to_nothing_else(tmp_path: Path) -> None:
    messages = _split(tmp_path / "real", "mcap")
    folder = tmp_path / "run"
    folder.mkdir()
    for part in range(3):
        (folder / f"run_{part}.mcap").symlink_to(tmp_path / "real" / f"run_{part}.mcap")
    os.mkfifo(folder / "pipe.mcap")
    (folder / "loop.mcap").symlink_to(folder / "loop.mcap")
    (folder / "device.mcap").symlink_to("/dev/zero")
    (folder / "folder.mcap").symlink_to(tmp_path / "real")
    (folder / "gone.mcap").symlink_to(tmp_path / "gone")
    with open_bag(folder) as bag:
        assert _read(bag) == _expected(messages)


def test_a_pipe_a_device_or_thousands_of_files_are_no_recording(tmp_path: Path) -> None:
    for number in range(MOST_MEMBERS + 1):
        (tmp_path / f"{number}").touch()
    with refused_as("BAG-019"):
        open_bag(tmp_path)
    os.mkfifo(tmp_path / "pipe.mcap")
    for path in (tmp_path / "pipe.mcap", Path("/dev/zero")):
        with pytest.raises(NotABagError):
            open_bag(path)


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_file_that_was_compressed_as_a_whole_is_read_alone(tmp_path: Path, suffix: str) -> None:
    messages = _messages()
    plain = WRITERS[suffix](tmp_path / f"run.{suffix}", messages)
    packed = tmp_path / f"run.{suffix}.zstd"
    packed.write_bytes(zstandard.compress(plain.read_bytes()))
    plain.unlink()
    for path in (packed, tmp_path):
        with open_bag(path) as bag:
            assert _read(bag) == _expected(messages)


def test_a_compressed_file_beside_its_original_is_read_once(tmp_path: Path) -> None:
    messages = _messages()
    plain = write_mcap(tmp_path / "run.mcap", messages)
    (tmp_path / "run.mcap.zstd").write_bytes(zstandard.compress(plain.read_bytes()))
    with open_bag(tmp_path) as bag:
        assert _read(bag) == _expected(messages)


def test_a_compressed_file_that_grows_without_measure_is_refused(tmp_path: Path) -> None:
    plain = write_mcap(tmp_path / "run.mcap", _messages()).read_bytes()
    codec = zstandard.ZstdCompressor().compressobj()
    pieces = [
        codec.compress(plain),
        *(codec.compress(bytes(2**20)) for _ in range(SMALL_BYTES // 2**20)),
        codec.flush(),
    ]
    (tmp_path / "bomb.mcap.zstd").write_bytes(b"".join(pieces))
    with refused_as("BAG-027"):
        open_bag(tmp_path / "bomb.mcap.zstd")
