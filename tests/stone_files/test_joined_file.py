"""joined.json: what is written is read, and what nobody joined is refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

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
    with pytest.raises(JoinedFileError, match=JOINED):
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
    with pytest.raises(JoinedFileError, match="join them again"):
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
