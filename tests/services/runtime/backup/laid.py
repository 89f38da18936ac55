"""A little of everything on a platform; and of two platforms what is compared: rows, objects, uploads."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from sqlalchemy import JSON, String, cast, select
from sqlalchemy.orm import Session

from services.runtime.orm import (
    AuditEntry,
    Base,
    CalibrationRow,
    IdempotentReply,
    Job,
    JobAttempt,
    LabelSet,
    Recording,
    SequenceRow,
    Upload,
    User,
    new_id,
)
from services.runtime.platform import Platform
from services.runtime.store.blobs import keep
from services.runtime.uploads import upload_file
from services.runtime.uploads.rows import UploadOwner
from testing.worlds.rows import recording_of
from tests.services.runtime.uploads.sending import made, send

HALF_SENT = b"half of a recording"
UNKEPT = b"a recording that no job has kept yet"
WORK = b"what the first stage left for the second"
ODD_TEXT = "tab\tline\nreturn\rbackslash\\ \\N é 漢 '\""
OF_PROCESSES = {"workers", "gc_holds", "alembic_version", "sqlite_stat1"}


@dataclass(frozen=True)
class Laid:
    """Ids of what was laid down."""

    owner: UploadOwner
    run_id: str
    job_id: str
    open_upload_id: str
    consumed_upload_id: str
    blob_sha256: str


def lay(platform: Platform, scratch: Path) -> Laid:
    """Two blobs, a run with a job that runs and a file of its work, an upload half sent, a recording not yet kept."""
    scratch.mkdir(exist_ok=True)
    with platform.database.transaction() as session:
        user = User(name=ODD_TEXT, role="curator", password_hash="argon")
        session.add(user)
        session.flush()
        owner = UploadOwner(user.id)
        calibration = _calibration(session, platform, owner, kept_file(scratch, b"rig"))
        sequence = SequenceRow(owner_id=owner.user_id, name="forest", calibration_id=calibration.id)
        session.add(sequence)
        session.flush()
        run_id, job_id = _jobs(session, owner, sequence)
        _label_set(session, sequence, run_id)
        _books(session, owner)
        blob_sha256 = calibration.blob_sha256
    platform.store.write(f"work/{run_id}/poses.bin", kept_file(scratch, WORK))
    half = made(platform, owner, HALF_SENT * 2)
    send(platform, half, 0, HALF_SENT)
    whole = send(platform, made(platform, owner, UNKEPT), 0, UNKEPT)
    _consume(platform, whole, sequence.id)
    return Laid(owner, run_id, job_id, half.id, whole.id, blob_sha256)


def kept_file(scratch: Path, content: bytes) -> Path:
    path = scratch / hashlib.sha256(content).hexdigest()[:12]
    path.write_bytes(content)
    return path


def rows_of(platform: Platform) -> dict[str, list[tuple[object, ...]]]:
    """Every row of every table that is not of processes; JSON as the text that is stored."""
    found = {}
    with platform.database.reading() as session:
        for table in Base.metadata.sorted_tables:
            if table.name not in OF_PROCESSES:
                columns = [
                    cast(column, String) if isinstance(column.type, JSON) else column for column in table.columns
                ]
                found[table.name] = sorted(map(tuple, session.execute(select(*columns)).all()), key=repr)
    return found


def objects_of(platform: Platform) -> dict[str, bytes]:
    return {stored.key: b"".join(platform.store.read(stored.key)) for stored in platform.store.listed("")}


def uploads_of(platform: Platform) -> dict[str, bytes]:
    folder = platform.settings.uploads_folder
    return {path.name: path.read_bytes() for path in folder.iterdir()} if folder.is_dir() else {}


def add_blob(platform: Platform, owner: UploadOwner, scratch: Path, content: bytes) -> CalibrationRow:
    """A blob and a row that needs it."""
    with platform.database.transaction() as session:
        return _calibration(session, platform, owner, kept_file(scratch, content))


def _calibration(session: Session, platform: Platform, owner: UploadOwner, path: Path) -> CalibrationRow:
    blob = keep(session, platform.store, path)
    row = CalibrationRow(owner_id=owner.user_id, name=new_id(), version=1, filename="rig.yaml", sha256=blob.sha256)
    row.blob_sha256, row.sensors, row.findings = blob.sha256, [{"t": [0.1, 1e-9, None]}], []
    session.add(row)
    session.flush()
    return row


def _jobs(session: Session, owner: UploadOwner, sequence: SequenceRow) -> tuple[str, str]:
    """A run with a job whose last attempt is under way."""
    shared = {"owner_id": owner.user_id, "sequence_id": sequence.id, "state": "running"}
    run = Job(id=new_id(), kind="sequence.process", **shared)
    run.root_id = run.id
    job = Job(id=new_id(), root_id=run.id, kind="ingest.synchronise", queue="ingest", attempt=3, **shared)
    job.attempts_left, job.arguments = 0, {"é": [1, 2.5, None]}
    session.add_all([run, job])
    session.flush()
    session.add(JobAttempt(job_id=job.id, number=3, worker="machine:1", cpu_s=0.1 + 0.2))
    return run.id, job.id


def _label_set(session: Session, sequence: SequenceRow, run_id: str) -> None:
    made_set = LabelSet(sequence_id=sequence.id, job_id=run_id, recipe="ab" * 32, code_version="1", frames=1)
    made_set.parameters, made_set.distance_m = {"alpha": 0.05}, 1 / 3
    session.add(made_set)
    session.flush()


def _books(session: Session, owner: UploadOwner) -> None:
    session.add(AuditEntry(number=1, actor="ada", act="x", facts={}, hash="0" * 64, reason=ODD_TEXT))
    reply = IdempotentReply(user_id=owner.user_id, route="POST /x", key="k", request_sha256="0" * 64)
    reply.body = bytes(range(256))
    session.add(reply)


def _consume(platform: Platform, upload: Upload, sequence_id: str) -> None:
    with platform.database.transaction() as session:
        row = session.get_one(Upload, upload.id)
        row.state = "consumed"
        recording: Recording = recording_of(row, sequence_id)
        recording.inspection = None  # JSON's null, which is not SQL's
        session.add(recording)


def upload_path(platform: Platform, upload_id: str) -> Path:
    return upload_file(platform.settings, upload_id)
