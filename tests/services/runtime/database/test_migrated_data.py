"""What an older version left in the database is there, in its new place, once the revisions have run."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from sqlalchemy import Connection, text

from services.runtime.database.migrate import alembic_on, schema_connection, upgrade
from services.runtime.database.transactions import Database
from services.runtime.orm import CalibrationRow, Recording
from services.runtime.settings import DatabaseSettings, Settings
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer

SHA = "ab" * 32
OLDER: dict[str, dict[str, Any]] = {
    "users": {"id": "u", "name": "ada", "role": "curator", "password_hash": "", "is_active": True, "created_ns": 1},
    "blobs": {"sha256": SHA, "object_key": "blobs/ab", "size_bytes": 7, "created_ns": 2},
    "calibrations": {
        "id": "c", "owner_id": "u", "name": "rig", "version": 1, "filename": "rig.yaml", "sha256": SHA,
        "blob_sha256": SHA, "sensors": "[]", "findings": "[]", "created_ns": 3,
    },
    "sequences": {
        "id": "s", "owner_id": "u", "name": "forest", "environment": "", "illumination": "", "region": "",
        "platform": "", "calibration_id": "c", "revision": 1, "created_ns": 4,
    },
    "uploads": {
        "id": "f", "owner_id": "u", "purpose": "recording", "target_id": "s", "filename": "run.mcap",
        "length_bytes": 7, "declared_sha256": "", "sha256": SHA, "state": "consumed", "detail": "", "created_ns": 5,
        "expires_ns": 6,
    },
    "recordings": {
        "id": "r", "sequence_id": "s", "upload_id": "f", "filename": "run.mcap", "size_bytes": 7, "sha256": SHA,
        "blob_sha256": SHA, "state": "registered", "inspection": '{"topics": []}', "findings": "[]", "created_ns": 7,
    },
}  # fmt: skip


@pytest.fixture(params=["sqlite", "postgres"])
def older(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Settings]:
    """Settings of a database of revision 0005 with a registered recording."""
    if request.param == "sqlite":
        yield filled(make_settings(tmp_path))
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        yield filled(make_settings(tmp_path, database=DatabaseSettings(url)))


def filled(settings: Settings) -> Settings:
    with schema_connection(settings) as connection:
        command.upgrade(alembic_on(connection), "0005")
        for table, row in OLDER.items():
            insert(connection, table, row)
    return settings


def insert(connection: Connection, table: str, row: dict[str, Any]) -> None:
    places = ", ".join(f":{name}" for name in row)
    connection.execute(text(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({places})"), row)


def test_an_older_recording_becomes_one_of_one_file(older: Settings) -> None:
    upgrade(older)
    database = Database(older)
    with database.reading() as session:
        recording, calibration = session.get_one(Recording, "r"), session.get_one(CalibrationRow, "c")
        (file,) = recording.files
    database.close()
    assert (recording.filename, recording.size_bytes, recording.sha256) == ("run.mcap", 7, SHA)
    assert (recording.state, recording.inspection, recording.quality) == ("registered", {"topics": []}, None)
    assert (file.ordinal, file.upload_id, file.filename, file.size_bytes) == (0, "f", "run.mcap", 7)
    assert (file.sha256, file.blob_sha256, file.recovered_blob_sha256) == (SHA, SHA, None)
    assert (calibration.format, calibration.valid_from_ns, calibration.valid_to_ns) == ("native", None, None)


def test_going_back_brings_every_older_row_back_as_it_was(older: Settings) -> None:
    upgrade(older)
    with schema_connection(older) as connection:
        command.downgrade(alembic_on(connection), "0005")
    with schema_connection(older) as connection:
        for table, row in OLDER.items():
            found = connection.execute(text(f"SELECT {', '.join(row)} FROM {table}")).mappings().one()
            expected = {name: str(value) for name, value in row.items() if name not in ("inspection", "is_active")}
            assert {name: str(found[name]) for name in expected} == expected, table


def test_going_back_tears_no_recording_of_several_files_apart(older: Settings) -> None:
    upgrade(older)
    second = {"id": "r2", "recording_id": "r", "ordinal": 1, "filename": "b", "size_bytes": 1, "sha256": SHA}
    with schema_connection(older) as connection:
        insert(connection, "recording_files", second)
    with pytest.raises(RuntimeError, match="1 files belong to recordings of several files"):  # noqa: SIM117
        with schema_connection(older) as connection:
            command.downgrade(alembic_on(connection), "0005")


def test_what_was_public_is_remembered_by_the_audit_log_and_else_from_its_making_on(older: Settings) -> None:
    sequence = OLDER["sequences"] | {"is_public": False}
    with schema_connection(older) as connection:
        command.upgrade(alembic_on(connection), "0020")
        for name, is_public in (("once", False), ("is", True), ("never", False)):
            insert(connection, "sequences", sequence | {"id": name, "name": name, "is_public": is_public})
        for number, facts in enumerate(({"is_public": True}, {"is_public": False}, {"name": "x"}), 1):
            line = {"number": number, "actor_id": "", "actor": "a", "act": "sequence.change", "subject_id": "once"}
            more = {"reason": "", "facts": json.dumps(facts), "request_id": "", "logged_ns": 90 + number}
            insert(connection, "audit_log", line | more | {"hash": str(number)})
    upgrade(older)
    with schema_connection(older) as connection:
        found = dict(connection.execute(text("SELECT id, published_ns FROM sequences")).all())
    assert found == {"once": 91, "is": 4, "never": None, "s": None}
