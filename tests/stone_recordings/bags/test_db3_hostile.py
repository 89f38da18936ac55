"""Whatever lies in a database, opening it gives messages or one coded refusal, and costs little time and memory."""

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

from stone.errors import StoneError
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.db3 import sql
from stone_recordings.bags.db3.pages import INTERIOR, MAGIC, Db3Pages
from stone_recordings.bags.errors import DatabaseRefusedError, MalformedBagError, PackedTooLargeError
from stone_recordings.bags.message_store import HEAD_BYTES
from tests.stone_recordings.databases import SCHEMAS, insert, write_db3
from tests.stone_recordings.writing import Recorded

ROOT = Path(__file__).resolve().parents[3]
GROWTH_LIMIT_BYTES = 64 * 2**20
IMU = "sensor_msgs/msg/Imu"
MESSAGES = [Recorded("/a", IMU, row, b"\x00\x01\x00\x00" + bytes([row % 251]) * 200) for row in range(300)]
ENDLESS = (
    "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT i AS id, 1 AS topic_id, i AS timestamp"
)


def _read(bag: Bag) -> dict[int, bytes]:
    return {m.log_time_ns: bytes(m.payload) for topic in bag.topics for m in bag.messages(topic.name)}


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
    "an endless view": (f"DROP TABLE messages; CREATE VIEW messages AS {ENDLESS}, x'00' AS data FROM n", "is a view"),
    "a virtual table": (
        "DROP TABLE messages; CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)",
        "not a recorder's: CREATE VIRTUAL TABLE",
    ),
    "a computed column": (
        "DROP TABLE messages; CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, "
        "seed BLOB, data BLOB AS (zeroblob(400000000)))",
        "not a recorder's",
    ),
    "a check": (_messages_table("CREATE TABLE messages(topic_id, timestamp, data, CHECK (zeroblob(9) > 1))"), "not a"),
    "a default": (_messages_table("CREATE TABLE messages(topic_id, timestamp, data DEFAULT (randomblob(9)))"), "not a"),
    "no rowids": (
        _messages_table("CREATE TABLE messages(id PRIMARY KEY, topic_id, timestamp, data) WITHOUT ROWID"),
        "not a recorder's",
    ),
    "other columns": (_messages_table("CREATE TABLE messages(id INTEGER PRIMARY KEY, a, b, c)"), "not a recorder's"),
    "another name inside": (_messages_table("CREATE TABLE nothing(topic_id, timestamp, data)"), "not a recorder's"),
    "a long line": (_messages_table("CREATE TABLE messages(topic_id, timestamp, data)" + " " * 70_000), "its schema"),
    "many objects": (
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n WHERE i < 300) "
        "INSERT INTO sqlite_master SELECT 'table', 't' || i, 't' || i, 2, 'CREATE TABLE t' || i || '(x)' FROM n",
        "more than 200 entries",
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_a_schema_that_is_no_recorders_is_refused_before_sqlite_sees_it(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    script, why = REFUSED[kind]
    path = _changed(tmp_path / "run.db3", script)
    monkeypatch.setattr(sql, "_connected", lambda _place: pytest.fail("SQLite was asked"))
    with pytest.raises(DatabaseRefusedError, match=why) as caught:
        open_bag(path)
    assert caught.value.code == "BAG-018"


def test_triggers_views_and_other_tables_beside_the_messages_are_never_touched(tmp_path: Path) -> None:
    script = f"""CREATE VIEW endless AS {ENDLESS} FROM n;
    CREATE TABLE mine(x, y AS (zeroblob(400000000)));
    CREATE TRIGGER deleting AFTER INSERT ON messages BEGIN DELETE FROM messages; END;
    CREATE INDEX other ON messages (topic_id, length(data));"""
    with open_bag(_changed(tmp_path / "run.db3", script)) as bag:
        assert _read(bag) == EXPECTED
        assert bag.findings == ()


@pytest.mark.parametrize(
    "statement",
    [
        "DELETE FROM messages",
        "ATTACH DATABASE ':memory:' AS other",
        "SELECT load_extension('x')",
        "SELECT * FROM beside",
        "SELECT randomblob(10)",
        "PRAGMA writable_schema = ON",
        "CREATE TABLE t(x)",
    ],
)
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
def test_a_tree_that_leads_to_one_page_again_and_again_ends(
    tmp_path: Path, is_checked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        assert _read(bag) == EXPECTED  # the leaves without a parent were found
        assert [finding.code for finding in bag.findings] == ["BAG-030"]


def test_a_row_that_claims_more_bytes_than_the_file_has_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_db3(tmp_path / "run.db3", [*MESSAGES, Recorded("/a", IMU, 999, bytes(20_000))])
    content = bytearray(path.read_bytes())
    at = content.index(_varint(20_009))  # the size of the last row
    content[at : at + 3] = b"\xff\xff\x7f"
    path.write_bytes(content)
    monkeypatch.setattr(sql, "CHECKED_BYTES", 0)
    with open_bag(path) as bag:
        assert _read(bag) == EXPECTED


def _varint(value: int) -> bytes:
    parts = [value & 0x7F]
    while value := value >> 7:
        parts.append(0x80 | value & 0x7F)
    return bytes(reversed(parts))


def _zeros_packed(count: int) -> bytes:
    """A frame of `count` MiB that does not say its size."""
    codec = zstandard.ZstdCompressor().compressobj()
    return b"".join([*(codec.compress(bytes(2**20)) for _ in range(count)), codec.flush()])


def test_a_message_that_unpacks_without_measure_is_refused_and_its_head_is_a_head(tmp_path: Path) -> None:
    path = write_db3(tmp_path / "run.db3", [Recorded("/a", IMU, 1, _zeros_packed(600))])
    with open_bag(path) as bag:
        ((_name, _index, head),) = bag.heads(("/a",))
        assert HEAD_BYTES <= len(head) <= 2**20
        with pytest.raises(PackedTooLargeError, match="decompress to more than 536870912"):
            bag.message("/a", 0)


def test_a_packed_message_that_was_cut_is_refused(tmp_path: Path) -> None:
    frame = zstandard.compress(b"\x00\x01\x00\x00" + np.random.default_rng(0).bytes(300_000))
    for size in (5, 12, 1000, len(frame) - 1):
        path = write_db3(tmp_path / f"{size}.db3", [Recorded("/a", IMU, 1, frame[:size])])
        with open_bag(path) as bag, pytest.raises(MalformedBagError, match="zstd frame"):
            bag.message("/a", 0)


GROWTH = """
import resource, sys
from pathlib import Path
from stone_recordings.bags.bag import open_bag
from stone.errors import StoneError
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
said = "read"
try:
    with open_bag(Path(sys.argv[1])) as bag:
        for topic in bag.topics:
            for message in bag.messages(topic.name):
                len(message.payload)
except StoneError as error:
    said = error.code
sys.stdout.write(f"{said} {(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024}")
"""


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
        file.truncate(2_000_000_000)


@pytest.mark.parametrize(("make", "said"), [(_bomb, "BAG-027"), (_wide_schema, "BAG-018"), (_hole, "read")])
def test_it_costs_little_memory(tmp_path: Path, make: Callable[[Path], None], said: str) -> None:
    make(tmp_path / "run.db3")
    command = [sys.executable, "-c", GROWTH, str(tmp_path / "run.db3")]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300, check=True)
    code, growth = done.stdout.split()
    assert code == said
    assert int(growth) <= GROWTH_LIMIT_BYTES


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
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
def test_a_changed_database_gives_messages_or_one_coded_refusal(
    tmp_path: Path, changes: list[tuple[int, bytes]], has_wal: bool
) -> None:
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
            _read(bag)
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
