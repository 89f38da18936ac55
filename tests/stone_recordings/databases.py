"""Rosbag2 databases as the recorder writes them, of every schema version, by stdlib sqlite3.

**Conventions.** The statements are those of rosbag2's sqlite storage: version 1 (Crystal), 2 (QoS), 3 (a `schema`
table, Humble), 4 (embedded definitions and type hashes, Iron). One transaction, journal mode of the caller's choice.
"""

import sqlite3
from collections.abc import Sequence
from pathlib import Path

from tests.stone_recordings.writing import Recorded, schema_text

MESSAGES = """CREATE TABLE messages(id INTEGER PRIMARY KEY,topic_id INTEGER NOT NULL,timestamp INTEGER NOT NULL,
 data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);"""
TOPICS = """CREATE TABLE topics(id INTEGER PRIMARY KEY,name TEXT NOT NULL,type TEXT NOT NULL,
 serialization_format TEXT NOT NULL"""
SCHEMA = """CREATE TABLE schema(schema_version INTEGER PRIMARY KEY,ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY,metadata_version INTEGER NOT NULL,metadata TEXT NOT NULL);"""
DEFINITIONS = """CREATE TABLE message_definitions(id INTEGER PRIMARY KEY,topic_type TEXT NOT NULL,
 encoding TEXT NOT NULL,encoded_message_definition TEXT NOT NULL,type_description_hash TEXT NOT NULL);"""
SCHEMAS: dict[int, str] = {
    1: f"{TOPICS});{MESSAGES}",
    2: f"{TOPICS},offered_qos_profiles TEXT NOT NULL);{MESSAGES}",
    3: f"{SCHEMA}{TOPICS},offered_qos_profiles TEXT NOT NULL);{MESSAGES}INSERT INTO schema VALUES (3, 'humble');",
    4: f"{SCHEMA}{TOPICS},offered_qos_profiles TEXT NOT NULL,type_description_hash TEXT NOT NULL);"
    f"{DEFINITIONS}{MESSAGES}INSERT INTO schema VALUES (4, 'jazzy');",
}


def write_db3(path: Path, messages: Sequence[Recorded], *, version: int = 4, encoding: str = "cdr") -> Path:
    """The database at `path`, closed."""
    connection = sqlite3.connect(path, isolation_level=None)
    connection.executescript(SCHEMAS[version])
    insert(connection, messages, version=version, encoding=encoding)
    connection.close()
    return path


def insert(
    connection: sqlite3.Connection, messages: Sequence[Recorded], *, version: int = 4, encoding: str = "cdr"
) -> None:
    """Topics as they are met, messages in the order given; one transaction."""
    connection.execute("BEGIN")
    known = {name: topic_id for topic_id, name in connection.execute("SELECT id, name FROM topics")}
    for message in messages:
        if message.topic not in known:
            known[message.topic] = len(known) + 1
            _declare(connection, known[message.topic], message, (version, encoding))
        row = (known[message.topic], message.log_time_ns, message.payload)
        connection.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)", row)
    connection.execute("COMMIT")


def _declare(connection: sqlite3.Connection, topic_id: int, message: Recorded, kind: tuple[int, str]) -> None:
    version, encoding = kind
    columns = (topic_id, message.topic, message.type, encoding, *("" for _column in range(min(version, 4) - 1)))
    columns = columns[: {1: 4, 2: 5, 3: 5, 4: 6}[version]]
    connection.execute(f"INSERT INTO topics VALUES ({', '.join('?' * len(columns))})", columns)
    if version == 4:
        row = (topic_id, message.type, "ros2msg", schema_text(message.type), "")
        connection.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", row)
