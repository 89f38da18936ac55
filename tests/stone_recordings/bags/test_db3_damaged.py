"""A database that was not closed, or whose pages are damaged, gives what is whole; the original is never written."""

import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stone.errors import StoneError
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.db3.pages import LEAF, Db3Pages
from stone_recordings.bags.errors import DatabaseRefusedError
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.report.inspection import inspect
from tests.stone_recordings.databases import SCHEMAS, insert, write_db3
from tests.stone_recordings.writing import Recorded

ROOT = Path(__file__).resolve().parents[3]
IMU = "sensor_msgs/msg/Imu"
PAGE_BYTES = 4096


def _messages(count: int, size_bytes: int = 300, start: int = 0) -> list[Recorded]:
    generator = np.random.default_rng(count + start)
    return [
        Recorded(f"/{'ab'[row % 2]}", IMU, 1000 + row, b"\x00\x01\x00\x00" + generator.bytes(size_bytes + row % 97))
        for row in range(start, start + count)
    ]


def _content(bag: Bag) -> dict[int, bytes]:
    """Log times are unique here."""
    return {m.log_time_ns: bytes(m.payload) for topic in bag.topics for m in bag.messages(topic.name)}


def _expected(messages: list[Recorded]) -> dict[int, bytes]:
    return {message.log_time_ns: message.payload for message in messages}


def _snapshot(folder: Path) -> dict[str, tuple[bytes, int]]:
    return {file.name: (file.read_bytes(), file.stat().st_mtime_ns) for file in sorted(folder.iterdir())}


def _crashed(folder: Path, journal: str, before: list[Recorded], after: list[Recorded]) -> Path:
    """The files as they lie when the recorder is gone: `before` committed, `after` too where there is a log."""
    live = folder / "live.db3"
    connection = sqlite3.connect(live, isolation_level=None)
    connection.execute(f"PRAGMA journal_mode = {journal}")
    connection.execute("PRAGMA wal_autocheckpoint = 0")
    connection.executescript(SCHEMAS[4])
    insert(connection, before)
    if journal == "WAL":
        insert(connection, after)
    else:
        connection.execute("PRAGMA cache_size = 5")  # so that unfinished pages reach the file
        connection.execute("BEGIN")
        for message in after:
            row = (1, message.log_time_ns, message.payload)
            connection.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    (folder / "run").mkdir()
    for file in folder.glob("live.db3*"):
        if not file.name.endswith("-shm"):
            shutil.copy(file, folder / "run" / file.name.replace("live", "run"))
    connection.close()
    return folder / "run" / "run.db3"


def test_the_log_beside_a_database_is_read_with_it(tmp_path: Path) -> None:
    before, after = _messages(50), _messages(70, start=50)
    path = _crashed(tmp_path, "WAL", before, after)
    held = _snapshot(path.parent)
    assert held["run.db3-wal"][0]
    for place in (path, path.parent):
        with open_bag(place) as bag:
            assert _content(bag) == _expected(before + after)
            assert ("BAG-029", "warning") in [(finding.code, finding.severity) for finding in bag.findings]
        assert _snapshot(path.parent) == held
    assert "BAG-029" in [finding.code for finding in inspect(path).findings]


def test_a_log_is_read_although_the_database_itself_was_never_written(tmp_path: Path) -> None:
    messages = _messages(20)
    path = _crashed(tmp_path, "WAL", messages, [])
    path.write_bytes(b"")
    with open_bag(path) as bag:
        assert _content(bag) == _expected(messages)


def test_a_log_that_was_cut_gives_the_transactions_before_the_cut(tmp_path: Path) -> None:
    before, after = _messages(50), _messages(70, start=50)
    path = _crashed(tmp_path, "WAL", before, after)
    wal = path.with_name("run.db3-wal")
    wal.write_bytes(wal.read_bytes()[:-5000])
    with open_bag(path) as bag:
        assert _content(bag) == _expected(before)


def test_an_unfinished_transaction_is_undone_in_a_copy(tmp_path: Path) -> None:
    before, after = _messages(50), _messages(400, start=50)
    path = _crashed(tmp_path, "DELETE", before, after)
    held = _snapshot(path.parent)
    assert held["run.db3-journal"][0]
    with open_bag(path) as bag:
        assert _content(bag) == _expected(before)
        assert [finding.code for finding in bag.findings] == ["BAG-029"]
    assert _snapshot(path.parent) == held


def test_a_journal_that_names_another_file_is_refused_and_the_file_stays(tmp_path: Path) -> None:
    """SQLite deletes the super-journal that the last bytes of a journal name."""
    path, victim = _crashed(tmp_path, "DELETE", _messages(50), _messages(400, start=50)), tmp_path / "victim"
    victim.write_bytes(b"precious")
    name = str(victim).encode()
    journal = path.with_name("run.db3-journal")
    tail = name + len(name).to_bytes(4, "big") + sum(name).to_bytes(4, "big") + b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
    journal.write_bytes(journal.read_bytes() + (2**30 // PAGE_BYTES + 1).to_bytes(4, "big") + tail)
    with pytest.raises(DatabaseRefusedError, match="names other files"):
        open_bag(path)
    assert victim.read_bytes() == b"precious"


KILLED = """
import os, signal, sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
connection.execute("PRAGMA journal_mode = MEMORY")
connection.execute("PRAGMA synchronous = OFF")
connection.execute("PRAGMA cache_size = 10")
for transaction in range(4):
    connection.execute("BEGIN")
    for row in range(200):
        number = 1000 + transaction * 200 + row
        payload = b"\\x00\\x01\\x00\\x00" + bytes([number % 251]) * (300 + number % 97)
        connection.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (1, ?, ?)", (number, payload))
        if transaction == 3 and row == 150:
            os.kill(os.getpid(), signal.SIGKILL)
    connection.execute("COMMIT")
"""


def test_a_recorder_killed_in_its_default_preset_loses_no_finished_transaction(tmp_path: Path) -> None:
    """rosbag2's default keeps the journal in memory, so a kill leaves pages of an unfinished transaction behind."""
    path = write_db3(tmp_path / "run.db3", [Recorded("/a", IMU, 1, b"\x00\x01\x00\x00")])
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], cwd=ROOT, check=False, timeout=300)
    assert done.returncode == -signal.SIGKILL
    with open_bag(path) as bag:
        content = _content(bag)
    assert set(content) >= {1, *range(1000, 1600)}
    for number, payload in content.items():
        assert number == 1 or payload == b"\x00\x01\x00\x00" + bytes([number % 251]) * (300 + number % 97)


def _leaves(path: Path) -> list[int]:
    """The leaf pages of the messages, in the order of the file."""
    pages = Db3Pages(memoryview(path.read_bytes()), memoryview(b""), path.name)
    counts = {
        number: len(list(pages.cells(number))) for number in range(2, pages.count + 1) if pages.kind(number) == LEAF
    }
    return [number for number, count in counts.items() if count > 3]


def _overwrite(path: Path, number: int, content: bytes) -> None:
    with path.open("r+b") as file:
        file.seek((number - 1) * PAGE_BYTES)
        file.write(content)


@pytest.mark.parametrize("content", [b"\x00" * PAGE_BYTES, b"\xff" * PAGE_BYTES, b"\x0d\xff\xff\xff\xff" * 700])
def test_a_damaged_leaf_costs_its_own_rows_and_is_said(tmp_path: Path, content: bytes) -> None:
    messages = _messages(300)
    path = write_db3(tmp_path / "run.db3", messages)
    leaves = _leaves(path)
    for number in (leaves[3], leaves[9]):
        _overwrite(path, number, content[:PAGE_BYTES])
    with open_bag(path) as bag:
        kept = _content(bag)
        assert kept.items() <= _expected(messages).items()
        lost = len(messages) - len(kept)
        assert 0 < lost <= 30
        (finding,) = bag.findings
        assert (finding.code, finding.severity) == ("BAG-030", "error")
        assert f"{len(kept)} messages could be read from its pages, at least {lost} more are lost" in finding.message
        heads = {bag.log_times_ns(name)[index]: bytes(head) for name, index, head in bag.heads(("/a", "/b"))}
        assert heads == kept


def test_a_damaged_root_page_costs_no_row(tmp_path: Path) -> None:
    """No tree leads to the leaves any more; each of them says itself that it holds messages."""
    messages = _messages(300)
    path = write_db3(tmp_path / "run.db3", messages)
    pages = Db3Pages(memoryview(path.read_bytes()), memoryview(b""), path.name)
    (root,) = [number for number in range(2, pages.count + 1) if pages.kind(number) == 5]
    _overwrite(path, root, b"\x00" * PAGE_BYTES)
    with open_bag(path) as bag:
        assert _content(bag) == _expected(messages)
        assert [finding.code for finding in bag.findings] == ["BAG-030"]


def test_a_damaged_chain_of_a_large_message_costs_that_message(tmp_path: Path) -> None:
    messages = _messages(30, 50_000)
    path = write_db3(tmp_path / "run.db3", messages)
    content = path.read_bytes()
    inside = content.index(messages[11].payload[20_000:20_050]) // PAGE_BYTES + 1
    _overwrite(path, inside, b"\x7f\xff\xff\xff")
    with open_bag(path) as bag:
        assert _content(bag) == _expected(messages[:11] + messages[12:])
        assert "at least 1 more are lost" in bag.findings[0].message


@pytest.mark.parametrize("share", [0.2, 0.5, 0.8, 0.97])
def test_a_database_that_was_cut_gives_the_rows_before_the_cut(tmp_path: Path, share: float) -> None:
    messages = _messages(300, 1500)
    path = write_db3(tmp_path / "run.db3", messages)
    os.truncate(path, int(path.stat().st_size * share))
    with open_bag(path) as bag:
        kept = _content(bag)
        assert kept.items() <= _expected(messages).items()
        assert len(kept) >= 0.9 * share * len(messages) - 15  # the first pages hold the schema
        assert bag.findings[0].code == "BAG-030"
    recovery = recover(path, tmp_path / "out.mcap")
    assert recovery.messages == len(kept)
    assert "is damaged" in recovery.lost
    with open_bag(tmp_path / "out.mcap") as bag:
        assert _content(bag) == kept


def test_a_database_without_a_readable_page_is_refused(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", _messages(20))
    path.write_bytes(path.read_bytes()[:100] + b"\x00" * 20_000)
    with pytest.raises(DatabaseRefusedError, match="no topic can be found"):
        open_bag(path)


def _bit_flips(content: bytes, generator: np.random.Generator) -> bytes:
    damaged = bytearray(content)
    for place in generator.integers(0, len(content), 12).tolist():
        damaged[place] ^= 1 << int(generator.integers(0, 8))
    return bytes(damaged)


def _page_swap(content: bytes, generator: np.random.Generator) -> bytes:
    first, second = generator.integers(0, len(content) // PAGE_BYTES, 2).tolist()
    damaged = bytearray(content)
    one, other = (slice(number * PAGE_BYTES, (number + 1) * PAGE_BYTES) for number in (first, second))
    damaged[one], damaged[other] = content[other], content[one]
    return bytes(damaged)


def _header_noise(content: bytes, generator: np.random.Generator) -> bytes:
    damaged = bytearray(content)
    page = int(generator.integers(0, len(content) // PAGE_BYTES)) * PAGE_BYTES
    at = page + (100 if page == 0 else 0)
    damaged[at : at + 12] = generator.bytes(12)
    return bytes(damaged)


@pytest.mark.parametrize("damage", [_bit_flips, _page_swap, _header_noise])
def test_whatever_the_damage_there_are_messages_or_one_coded_refusal(
    tmp_path: Path, damage: Callable[[bytes, np.random.Generator], bytes]
) -> None:
    content = write_db3(tmp_path / "whole.db3", _messages(60) + _messages(10, 9000, start=60)).read_bytes()
    generator = np.random.default_rng(5)
    for round_number in range(60):
        path = tmp_path / f"damaged{round_number}.db3"
        path.write_bytes(damage(content, generator))
        try:
            with open_bag(path) as bag:
                _content(bag)
                list(bag.heads([topic.name for topic in bag.topics]))
        except StoneError as error:
            assert error.code.startswith("BAG-")  # noqa: PT017 – most rounds do not raise
