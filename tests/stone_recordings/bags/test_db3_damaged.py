"""A database that was not closed, or whose pages are damaged, gives what is whole; the original is never written."""

import os
import shutil
import signal
import sqlite3
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from services.runtime.sandbox import SandboxLimits, sandboxed
from stone.errors import StoneError
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.db3 import sql
from stone_recordings.bags.db3.pages import INTERIOR, LEAF, MAGIC, Db3Pages
from stone_recordings.bags.errors import MalformedBagError
from stone_recordings.bags.message_store import HEAD_BYTES
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.report.inspection import inspect
from testing.refusals import refused_as
from tests.stone_recordings.bags.memory_growth import GROWTH_LIMIT_BYTES, growth_of
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


@pytest.mark.parametrize("journal", ["WAL", "DELETE"])
@pytest.mark.parametrize("makes_links", [True, False])
def test_a_database_that_was_not_closed_is_read_by_a_child_that_changes_no_mode(
    journal: str, makes_links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before, after = _messages(50), _messages(400, start=50)
    path = _crashed(tmp_path, journal, before, after)
    own = tmp_path / "own"
    own.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(own))

    def work() -> bytes:
        with open_bag(path) as bag:
            return str(len(_content(bag))).encode()

    limits = SandboxLimits(folder=own, file_bytes=2**30, reads=(path.parent,), makes_links=makes_links)
    assert sandboxed(work, limits) == (b"450" if journal == "WAL" else b"50")


def test_a_journal_that_names_another_file_is_refused_and_the_file_stays(tmp_path: Path) -> None:
    """SQLite deletes the super-journal that the last bytes of a journal name."""
    path, victim = _crashed(tmp_path, "DELETE", _messages(50), _messages(400, start=50)), tmp_path / "victim"
    victim.write_bytes(b"precious")
    name = str(victim).encode()
    journal = path.with_name("run.db3-journal")
    tail = name + len(name).to_bytes(4, "big") + sum(name).to_bytes(4, "big") + b"\xd9\xd5\x05\xf9\x20\xa1\x63\xd7"
    journal.write_bytes(journal.read_bytes() + (2**30 // PAGE_BYTES + 1).to_bytes(4, "big") + tail)
    with refused_as("BAG-018"):
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
    with open_bag(tmp_path / "out.mcap") as bag:
        assert _content(bag) == kept


def test_a_database_without_a_readable_page_is_refused(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", _messages(20))
    path.write_bytes(path.read_bytes()[:100] + b"\x00" * 20_000)
    with refused_as("BAG-018"):
        open_bag(path)


MESSAGES = [Recorded("/a", IMU, row, b"\x00\x01\x00\x00" + bytes([row % 251]) * 200) for row in range(300)]
ENDLESS = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp"
)


EXPECTED = {message.log_time_ns: message.payload for message in MESSAGES}


def _changed(path: Path, script: str) -> Path:
    """A sound database with `script` run over it, its schema writable."""
    write_db3(path, MESSAGES)
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript(f"PRAGMA writable_schema = ON;{script}")
    connection.close()
    return path


def _messages_table(definition: str) -> str:
    """The table of messages replaced by another definition."""
    quoted = definition.replace("'", "''")
    return f"UPDATE sqlite_master SET sql = '{quoted}' WHERE type = 'table' AND name = 'messages'"


REFUSED = {
    "an endless view": f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS}, x'00' AS data FROM n",
    "a virtual table": "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)",
    "a computed column": "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, "
        "timestamp INTEGER, seed BLOB, data BLOB AS (zeroblob(400000000)))",
    "a check": _messages_table("CREATE TABLE messages(topic_id, timestamp, data, CHECK (zeroblob(9) > 1))"),
    "a default": _messages_table("CREATE TABLE messages(topic_id, timestamp, data DEFAULT (randomblob(9)))"),
    "no rowids": _messages_table("CREATE TABLE messages(id PRIMARY KEY, topic_id, timestamp, data) WITHOUT ROWID"),
    "other columns": _messages_table("CREATE TABLE messages(id INTEGER PRIMARY KEY, a, b, c)"),
    "another name inside": _messages_table("CREATE TABLE nothing(topic_id, timestamp, data)"),
    "a long line": _messages_table("CREATE TABLE messages(topic_id, timestamp, data)" + " " * 70_000),
    "many objects": "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 300) "
        "INSERT INTO sqlite_master SELECT 'table', 't' || i, 't' || i, 2, 'CREATE TABLE t' || i || '(x)' FROM n",
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_a_schema_that_is_no_recorders_is_refused_before_sqlite_sees_it(tmp_path, kind, monkeypatch):
    path = _changed(tmp_path / "run.db3", REFUSED[kind])
    monkeypatch.setattr(sql, "_connected", lambda _place: pytest.fail("SQLite was asked"))
    with refused_as("BAG-018"):
        open_bag(path)


def test_triggers_views_and_other_tables_beside_the_messages_are_never_touched(tmp_path: Path) -> None:
    script = f"""CREATE VIEW endless AS {ENDLESS} FROM n;
    CREATE TABLE mine(x, y AS (zeroblob(400000000)));
    CREATE TRIGGER deleting AFTER INSERT ON messages BEGIN DELETE FROM messages; END;
    CREATE INDEX other ON messages (topic_id, length(data));"""
    with open_bag(_changed(tmp_path / "run.db3", script)) as bag:
        assert _content(bag) == EXPECTED
        assert bag.findings == ()


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM messages", "ATTACH DATABASE ':memory:' AS other", "SELECT load_extension('x')",
        "SELECT * FROM beside", "SELECT randomblob(10)", "PRAGMA writable_schema = ON", "CREATE TABLE t(x)",
    ],
)  # fmt: skip
def test_the_connection_permits_nothing_but_reading_the_recording(tmp_path: Path, statement: str) -> None:
    path = _changed(tmp_path / "run.db3", "CREATE VIEW beside AS SELECT * FROM messages")
    with open_bag(path) as bag:
        connection = bag._store._rows._connection  # type: ignore[attr-defined]
        with pytest.raises(sqlite3.Error, match=r"not authorized|prohibited|no such"):
            connection.execute(statement)


def _interior_root(path: Path) -> tuple[int, int]:
    pages = Db3Pages(memoryview(path.read_bytes()), memoryview(b""), path.name)
    (root,) = [number for number in range(2, pages.count + 1) if pages.kind(number) == INTERIOR]
    return root, next(iter(pages.children(root)))


@pytest.mark.parametrize("is_checked", [True, False])
def test_a_tree_that_leads_to_one_page_again_and_again_ends(tmp_path, is_checked, monkeypatch):
    """Twenty levels of such pages would have more rows than there are atoms."""
    path = write_db3(tmp_path / "run.db3", MESSAGES)
    root, first = _interior_root(path)
    content = bytearray(path.read_bytes())
    page = memoryview(content)[(root - 1) * 4096 : root * 4096]
    (count,) = struct.unpack_from(">H", page, 3)
    for slot in range(count):
        struct.pack_into(">I", page, struct.unpack_from(">H", page, 12 + 2 * slot)[0], first)
    path.write_bytes(content)
    if not is_checked:
        monkeypatch.setattr(sql, "CHECKED_BYTES", 0)
    with open_bag(path) as bag:
        assert _content(bag) == EXPECTED  # the leaves without a parent were found
        assert [finding.code for finding in bag.findings] == ["BAG-030"]


def test_a_row_that_claims_more_bytes_than_the_file_has_is_left_out(tmp_path, monkeypatch):
    path = write_db3(tmp_path / "run.db3", [*MESSAGES, Recorded("/a", IMU, 999, bytes(20_000))])
    content = bytearray(path.read_bytes())
    at = content.index(_varint(20_009))  # the size of the last row
    content[at : at + 3] = b"\xff\xff\x7f"
    path.write_bytes(content)
    monkeypatch.setattr(sql, "CHECKED_BYTES", 0)
    with open_bag(path) as bag:
        assert _content(bag) == EXPECTED


def _varint(value: int) -> bytes:
    parts = [value & 0x7F]
    while value := value >> 7:
        parts.append(0x80 | value & 0x7F)
    return bytes(reversed(parts))


def _zeros_packed(count: int) -> bytes:
    """A frame of `count` MiB that does not say its size."""
    codec = zstandard.ZstdCompressor().compressobj()
    return b"".join([*(codec.compress(bytes(2**20)) for _ in range(count)), codec.flush()])


def test_a_message_that_unpacks_without_measure_or_was_cut_is_refused(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", [Recorded("/a", IMU, 1, _zeros_packed(600))])
    with open_bag(path) as bag:
        ((_name, _index, head),) = bag.heads(("/a",))
        assert HEAD_BYTES <= len(head) <= 2**20
        with refused_as("BAG-027"):
            bag.message("/a", 0)
    frame = zstandard.compress(b"\x00\x01\x00\x00" + np.random.default_rng(0).bytes(300_000))
    for size in (5, 12, 1000, len(frame) - 1):
        path = write_db3(tmp_path / f"{size}.db3", [Recorded("/a", IMU, 1, frame[:size])])
        with open_bag(path) as bag, pytest.raises(MalformedBagError):
            bag.message("/a", 0)


def _bomb(path: Path) -> None:
    write_db3(path, [Recorded("/a", IMU, 1, _zeros_packed(600))])


def _wide_schema(path: Path) -> None:
    _changed(
        path,
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 100000) "
        "INSERT INTO sqlite_master SELECT 'table', 't' || i, 't' || i, 2, 'CREATE TABLE t' || i || '(x)' FROM n",
    )


def _hole(path: Path) -> None:
    write_db3(path, MESSAGES)
    with path.open("r+b") as file:
        file.truncate(600_000_000)


@pytest.mark.whole
@pytest.mark.parametrize(("make", "said"), [(_bomb, "BAG-027"), (_wide_schema, "BAG-018"), (_hole, "read")])
def test_it_costs_little_memory(tmp_path: Path, make: Callable[[Path], None], said: str) -> None:
    make(tmp_path / "run.db3")
    code, growth_bytes = growth_of(tmp_path / "run.db3")
    assert code == said
    assert growth_bytes <= GROWTH_LIMIT_BYTES


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300), has_magic=st.booleans(), is_long=st.booleans())
def test_random_bytes_are_refused(tmp_path: Path, content: bytes, has_magic: bool, is_long: bool) -> None:
    path = tmp_path / "random.db3"
    path.write_bytes((MAGIC if has_magic else b"") + content + bytes(8192 if is_long else 0))
    with pytest.raises(StoneError):
        open_bag(path)


@pytest.mark.whole
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    changes=st.lists(st.tuples(st.integers(0, 2**20), st.binary(min_size=1, max_size=8)), min_size=1, max_size=8),
    has_wal=st.booleans(),
)
def test_a_changed_database_gives_messages_or_one_coded_refusal(tmp_path, changes, has_wal):
    """Catches alone a database, or a log beside it, with bytes changed anywhere, that crashes its reader."""
    main, wal = _parts()
    path = tmp_path / "run.db3"
    damaged = bytearray(wal if has_wal else main)
    for at, content in changes:
        place = at % len(damaged)
        damaged[place : place + len(content)] = content[: len(damaged) - place]
    path.write_bytes(main if has_wal else damaged)
    path.with_name("run.db3-wal").write_bytes(damaged if has_wal else b"")
    try:
        with open_bag(path) as bag:
            _content(bag)
    except StoneError as error:
        assert error.code.startswith("BAG-")  # noqa: PT017 – most examples do not raise


@cache
def _parts() -> tuple[bytes, bytes]:
    """A small database and the log of a later transaction."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.db3"
        connection = sqlite3.connect(path, isolation_level=None)
        connection.executescript(f"PRAGMA page_size = 512; PRAGMA journal_mode = WAL;{SCHEMAS[3]}")
        insert(connection, MESSAGES[:20], version=3)
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        connection.execute("PRAGMA wal_autocheckpoint = 0")
        insert(connection, MESSAGES[20:40], version=3)
        parts = path.read_bytes(), path.with_name("run.db3-wal").read_bytes()
        connection.close()
    return parts
