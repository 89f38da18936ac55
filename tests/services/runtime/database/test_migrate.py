"""The schema: what the revisions make is what the rows say, on both databases, however many start at once.

What an older version left in the database is there, in its new place, once the revisions have run.
"""

import json
import multiprocessing
from random import Random
from typing import Any

import numpy as np
import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.operations import Operations
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import Connection, inspect, text, update

from services.runtime.access.users import create_user
from services.runtime.database.migrate import (
    MIGRATIONS,
    alembic_on,
    head_revision,
    is_known,
    schema_connection,
    upgrade,
)
from services.runtime.database.migrations.versions.r0001_r0020 import r0008_datasets
from services.runtime.database.transactions import Database
from services.runtime.errors import BrokenReferenceError, NewerSchemaError
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import (
    Artefact,
    Base,
    Blob,
    CalibrationRow,
    LabelledFrameRow,
    LabelSet,
    Recording,
    SequenceRow,
)
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from stone.splits.composition import duration_ns

ORDERED = "ix_jobs_ready"
"""An index with a column in descending order, which SQLite does not tell when it is asked for its indexes."""


def test_a_database_of_a_newer_version_is_refused(platform: Platform) -> None:
    with platform.database.transaction() as session:
        session.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    with pytest.raises(NewerSchemaError):
        upgrade(platform.settings)


def test_a_change_that_leaves_a_row_without_its_parent_is_undone(platform: Platform) -> None:
    with pytest.raises(BrokenReferenceError):  # noqa: SIM117
        with schema_connection(platform.settings) as connection:
            connection.execute(
                text("INSERT INTO tokens VALUES ('t', 'nobody', 'n', 'h', '[]', 1, 2, NULL, NULL)"),
            )
    with platform.database.reading() as session:
        assert session.scalar(text("SELECT count(*) FROM tokens")) == 0


def test_the_revisions_make_exactly_the_tables_of_the_rows(platform_on: Platform) -> None:
    with platform_on.database.engine.connect() as connection:
        hidden = {ORDERED} if connection.dialect.name == "sqlite" else set()
        include = {"include_object": lambda _object, name, *_: name not in hidden}
        context = MigrationContext.configure(connection, opts={"compare_server_default": True, **include})
        assert compare_metadata(context, Base.metadata) == []


def test_an_upgrade_of_an_upgraded_database_changes_nothing(platform: Platform) -> None:
    with platform.database.transaction() as session:
        session.execute(text("INSERT INTO queues VALUES ('ingest', 'paused')"))
    upgrade(platform.settings)
    with platform.database.reading() as session:
        assert session.execute(text("SELECT name, mode FROM queues")).all() == [("ingest", "paused")]


@pytest.mark.whole
def test_processes_that_upgrade_at_once_all_succeed(empty: Settings) -> None:
    """Catches alone two processes that change the schema at once."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=upgrade, args=(empty,)) for _ in range(2)]
    for process in processes:
        process.start()
    for process in processes:
        process.join(300)
    assert [process.exitcode for process in processes] == [0, 0]
    assert tables_of(empty) == {*Base.metadata.tables, "alembic_version"}


@pytest.mark.whole
def test_downgrading_to_the_base_leaves_no_table(empty: Settings) -> None:
    upgrade(empty)
    with schema_connection(empty) as connection:
        command.downgrade(alembic_on(connection), "base")
    assert tables_of(empty) == {"alembic_version"}


def tables_of(settings: Settings) -> set[str]:
    database = Database(settings)
    names = set(inspect(database.engine).get_table_names())
    database.close()
    return names


def test_the_command_that_writes_a_revision_knows_all_and_writes_into_the_last_folder() -> None:
    """Its file lists the folders; this code walks them."""
    revisions = ScriptDirectory.from_config(Config(MIGRATIONS / "alembic.ini"))
    assert revisions.get_current_head() == head_revision()
    assert all(is_known(each.revision) for each in revisions.walk_revisions())
    files = sorted(MIGRATIONS.glob("versions/*/r*.py"))
    assert len(list(revisions.walk_revisions())) == len(files)
    assert revisions.get_revision(head_revision()).path == str(files[-1])


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


@pytest.fixture
def older(empty: Settings) -> Settings:
    """Settings of a database of revision 0005 with a registered recording."""
    return filled(empty)


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


STARTED_NS = 1_777_800_000_000_000_000


def labelled(platform: Platform, stamps_ns: list[int]) -> str:
    """The id of a label set with frames of these stamps, of a version that kept no duration."""
    with platform.database.transaction() as session:
        owner = create_user(session, "ada", "curator")
        sequence = SequenceRow(owner_id=owner.id, name="run")
        session.add_all([sequence, Blob(sha256="ab" * 32, object_key="blobs/ab", size_bytes=1)])
        session.flush()
        run = enqueue_run(session, "sequence.process", [JobSpec("ingest.synchronise")], Context(owner.id, sequence.id))
        labels = LabelSet(sequence_id=sequence.id, job_id=run.id, recipe="r", parameters={}, code_version="0", frames=1)
        session.add(labels)
        session.flush()
        pack = Artefact(label_set_id=labels.id, name="labels/000000.pack", media_type="", size_bytes=1)
        pack.blob_sha256 = "ab" * 32
        session.add(pack)
        session.flush()
        facts = {"label_set_id": labels.id, "pack_id": pack.id, "offset_bytes": 0, "length_bytes": 1, "sha256": ""}
        session.add_all(
            LabelledFrameRow(ordinal=n, token=f"{n:032x}", stamp_ns=stamp, **facts) for n, stamp in enumerate(stamps_ns)
        )
        session.execute(update(LabelSet).values(duration_ns=None))
        return labels.id


@pytest.mark.parametrize("frames", [0, 1, 7])
def test_the_revision_fills_in_what_the_labeler_would_write(platform_on: Platform, frames: int) -> None:
    random = Random(frames)
    stamps = np.cumsum([STARTED_NS, *(random.randrange(9 * 10**7, 11 * 10**7) for _ in range(frames))])[:frames]
    label_set_id = labelled(platform_on, stamps.tolist())
    with platform_on.database.engine.begin() as connection:
        context = MigrationContext.configure(connection)
        with Operations.context(context):
            r0008_datasets._fill_durations()
    with platform_on.database.reading() as session:
        assert session.get_one(LabelSet, label_set_id).duration_ns == duration_ns(stamps)


def test_a_sequence_lasts_as_long_as_its_frames_stand_for() -> None:
    stamps = STARTED_NS + 10**8 * np.arange(200)
    assert duration_ns(stamps) == 20 * 10**9, "200 frames at 10 Hz are 20 s, not 19.9"
