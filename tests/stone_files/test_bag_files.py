"""Which files are one bag, and what the whole is called by content."""

import json
import subprocess
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_files.bag_fingerprint import (
    HASH_BLOCK_BYTES,
    MOST_FILES,
    bag_parts,
    check_bag_files,
    hashed_meanwhile,
    recording_sha256,
    whole_sha256,
)
from stone_files.joined_file import (
    JOINED,
    MOST_BYTES,
    MOST_MEMBERS,
    MOST_OFFSET_NS,
    MOST_RUNS,
    SOURCES,
    JoinedFileError,
    JoinedMember,
    is_member_name,
    joined_bytes,
    member_path,
    read_joined,
)
from testing.refusals import refused_as

SPLIT = [f"run_{number}.mcap" for number in range(3)]


@pytest.mark.parametrize(
    "names",
    [
        ["metadata.yaml", *SPLIT], ["run_0.db3", "run_1.db3"], ["run_0.db3", "run_0.db3-wal", "metadata.yaml"],
        ["run_0.db3", "run_0.db3-journal"], ["run_0.mcap.zstd", "run_1.mcap"], ["metadata.yaml", "RUN.MCAP"],
        ["run_0.bag", "run_1.bag.active"], ["run_0.db3", "field_msgs.Reading.msg"],
    ],
)  # fmt: skip
def test_the_files_of_a_rosbag2_folder_are_one_bag(names: list[str]) -> None:
    check_bag_files(names)


@pytest.mark.parametrize(
    "names",
    [
        ["run.mcap"], [f"{number}.mcap" for number in range(MOST_FILES + 1)], ["metadata.yaml", "notes.txt"],
        ["field_msgs.Part.msg", "field_msgs.Reading.msg"], ["run_0.db3", "reading.msg"],
        ["metadata.yaml", "metadata.yaml"], ["run.mcap", "RUN.mcap"], ["run.mcap", "run.db3"],
        ["run_0.db3", "run_1.db3-wal"], ["run_0.mcap", "run_0.db3-wal"], ["metadata.yaml", "run.db3-wal"],
        ["Metadata.yaml", "run.mcap"],
    ],
)  # fmt: skip
def test_files_that_cannot_be_one_bag_are_refused_with_the_reason(names: list[str]) -> None:
    with refused_as("bad_recording_files"):
        check_bag_files(names)


def test_the_hash_of_the_whole_is_that_of_what_sha256sum_prints(tmp_path: Path) -> None:
    for name in ("b.mcap", "a.mcap", "metadata.yaml"):
        (tmp_path / name).write_text(name)
    names = ["a.mcap", "b.mcap", "metadata.yaml"]
    printed = subprocess.run(["sha256sum", *names], cwd=tmp_path, capture_output=True, check=True).stdout
    (tmp_path / "notes.txt").write_text("no part of the bag")
    (tmp_path / "a.db3-wal").write_text("")
    assert recording_sha256(tmp_path) == sha256(printed).hexdigest()
    files = [(name, sha256(name.encode()).hexdigest()) for name in reversed(names)]
    assert whole_sha256(files) == recording_sha256(tmp_path)


def test_a_database_and_its_journal_are_one_bag(tmp_path: Path) -> None:
    (tmp_path / "run.db3").write_text("pages")
    alone = recording_sha256(tmp_path / "run.db3")
    (tmp_path / "run.db3-wal").write_text("")
    assert bag_parts(tmp_path / "run.db3") == [tmp_path / "run.db3"]
    (tmp_path / "run.db3-wal").write_text("more pages")
    assert bag_parts(tmp_path / "run.db3") == [tmp_path / "run.db3", tmp_path / "run.db3-wal"]
    assert recording_sha256(tmp_path / "run.db3") != alone
    assert alone == sha256(b"pages").hexdigest()


@pytest.mark.parametrize("size", [0, 1, HASH_BLOCK_BYTES, 2 * HASH_BLOCK_BYTES + 7])
def test_it_is_that_of_the_bytes(tmp_path: Path, size: int) -> None:
    path = tmp_path / "run.mcap"
    path.write_bytes(bytes(range(256)) * (size // 256) + b"x" * (size % 256))
    with hashed_meanwhile(path) as found:
        assert found() == {path.name: recording_sha256(path)} == {path.name: sha256(path.read_bytes()).hexdigest()}


def test_a_known_hash_is_not_computed_again_and_a_file_that_went_away_is_said(tmp_path: Path) -> None:
    with hashed_meanwhile(tmp_path / "gone.mcap", "ab" * 32) as found:
        assert found() == {"gone.mcap": "ab" * 32}
    with hashed_meanwhile(tmp_path / "gone.mcap") as found, pytest.raises(FileNotFoundError):
        found()


def test_a_refusal_does_not_wait_for_the_rest(tmp_path: Path) -> None:
    """Given up before its first block, the hash is of nothing; a sparse file of a terabyte would take many minutes."""
    path = tmp_path / "run.mcap"
    with path.open("wb") as file:
        file.truncate(1 << 40)
    assert recording_sha256(path, lambda: True) == sha256(b"").hexdigest()
    with pytest.raises(ZeroDivisionError), hashed_meanwhile(path):
        raise ZeroDivisionError


NAMES = st.text("abc.é-_ 1", min_size=1, max_size=20).filter(is_member_name)
MEMBERS = st.builds(
    JoinedMember,
    NAMES,
    st.integers(-MOST_OFFSET_NS, MOST_OFFSET_NS),
    st.none() | st.integers(0, 10**9),
    st.lists(st.sampled_from(SOURCES), max_size=3).map(tuple),
    st.lists(st.text(max_size=9), max_size=3).map(tuple),
    st.dictionaries(st.text(max_size=9), st.just(((0, 4), (6, 9))), max_size=3),
    st.sampled_from(["", "ab" * 32]),
)
PLAIN: dict[str, Any] = {
    "name": "a.mcap", "offset_ns": 0, "sigma_ns": None, "known_by": ["reference"], "kept_topics": [], "left_out": {},
    "sha256": "",
}  # fmt: skip


@given(members=st.lists(MEMBERS, min_size=1, max_size=5, unique_by=lambda one: one.name.casefold()))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, members: list[JoinedMember]) -> None:
    folder = tmp_path_factory.mktemp("joined")
    (folder / JOINED).write_bytes(joined_bytes(members))
    assert read_joined(folder) == tuple(members)
    assert joined_bytes(read_joined(folder)) == (folder / JOINED).read_bytes()


def described(folder: Path, *members: Any, **changed: Any) -> Path:
    record = {"format": "stone-joined-recording", "version": 1, "members": list(members), **changed}
    (folder / JOINED).write_text(json.dumps(record))
    return folder


@pytest.mark.parametrize(
    "change",
    [
        {"name": "../secret.mcap"}, {"name": "/etc/passwd"}, {"name": ".."}, {"name": ""}, {"name": ".hidden.mcap"},
        {"name": "a/b.mcap"}, {"name": "a\\b.mcap"}, {"name": "a\0.mcap"}, {"name": "x" * 256}, {"name": JOINED},
        {"name": "Joined.JSON"}, {"name": 7}, {"offset_ns": MOST_OFFSET_NS + 1}, {"offset_ns": -MOST_OFFSET_NS - 1},
        {"offset_ns": 10**30}, {"offset_ns": 0.5}, {"offset_ns": True}, {"offset_ns": "0"}, {"sigma_ns": -1},
        {"sigma_ns": 10**30}, {"sigma_ns": "x"}, {"known_by": ["guess"]}, {"known_by": "given"}, {"known_by": [1]},
        {"kept_topics": {}}, {"left_out": []}, {"left_out": {"/a": [[3, 1]]}}, {"left_out": {"/a": [[-1, 1]]}},
        {"left_out": {"/a": [[0, 2], [1, 3]]}}, {"left_out": {"/a": [[0]]}}, {"left_out": {"/a": [[0, 2**60]]}},
        {"left_out": {"/a": [[0, True]]}}, {"left_out": {"/a": 7}}, {"sha256": "zz"}, {"sha256": None}, {"more": 1},
    ],
    ids=lambda change: str(change)[:40],
)  # fmt: skip
def test_a_member_that_cannot_be_is_refused(tmp_path: Path, change: dict[str, Any]) -> None:
    with pytest.raises(JoinedFileError):
        read_joined(described(tmp_path, {**PLAIN, **change}))


def _lacking(name: str) -> dict[str, Any]:
    return {key: value for key, value in PLAIN.items() if key != name}


@pytest.mark.parametrize(
    "write",
    [
        lambda folder: (folder / JOINED).write_bytes(b""),
        lambda folder: (folder / JOINED).write_bytes(b"\xff\xfe{"),
        lambda folder: (folder / JOINED).write_bytes(b"[" * 100_000),
        lambda folder: (folder / JOINED).write_bytes(b" " * (MOST_BYTES + 1)),
        lambda folder: (folder / JOINED).write_text("[]"),
        lambda folder: (folder / JOINED).write_text('{"members": ' + "9" * 5000 + "}"),
        lambda folder: described(folder),
        lambda folder: described(folder, "a.mcap"),
        lambda folder: described(folder, _lacking("name")),
        lambda folder: described(folder, PLAIN, version=2),
        lambda folder: described(folder, PLAIN, format="bag"),
        lambda folder: described(folder, PLAIN, {**PLAIN, "name": "A.MCAP"}),
        lambda folder: described(folder, *({**PLAIN, "name": f"{n}.mcap"} for n in range(MOST_MEMBERS + 1))),
        lambda folder: described(
            folder, {**PLAIN, "left_out": {"/a": [[2 * n, 2 * n + 1] for n in range(MOST_RUNS + 1)]}}
        ),
    ],
)
def test_a_description_that_cannot_be_is_refused(tmp_path: Path, write: Callable[[Path], Any]) -> None:
    write(tmp_path)
    with pytest.raises(JoinedFileError):
        read_joined(tmp_path)


def test_what_would_be_refused_is_not_written() -> None:
    with pytest.raises(JoinedFileError):
        joined_bytes([JoinedMember("../a.mcap")])
    with pytest.raises(JoinedFileError):
        joined_bytes([])


def test_a_member_that_is_missing_or_joined_itself_is_refused(tmp_path: Path) -> None:
    """A link to the folder itself would go round for ever."""
    described(tmp_path, PLAIN)
    (tmp_path / "loop").symlink_to(tmp_path)
    for name in ("gone.mcap", "loop"):
        with pytest.raises(JoinedFileError):
            member_path(tmp_path, JoinedMember(name))
