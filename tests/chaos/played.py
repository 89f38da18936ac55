"""A round that ended well, as rows and objects; for tests that then spoil one thing."""

from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TypeVar

from sqlalchemy.orm import Session

from chaos.result_hashes import OwnerRun, RunArtefacts, made_by
from services.runtime.access import storage_quota
from services.runtime.orm import (
    Artefact,
    Base,
    Job,
    JobAttempt,
    LabelledFrameRow,
    LabelSet,
    SequenceRow,
    Upload,
    User,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.uploads.files import upload_file
from testing.worlds.rows import recording_of

Row = TypeVar("Row", bound=Base)
BAG = b"a recording" * 100
PACK = b"labels of the first frame, labels of the second"
CUT = 27
GIB = 2**30


@dataclass(frozen=True)
class Played:
    """The platform, what was brought, and what was made of it."""

    platform: Platform
    brought: OwnerRun
    made: RunArtefacts


def play_well(platform: Platform, folder: Path) -> Played:
    """Sent, registered, processed by two jobs of which one was lost once, published."""
    with platform.database.transaction() as session:
        owner = added(session, User(name="ada", role="curator"))
        sequence = added(session, SequenceRow(owner_id=owner.id, name="chaos"))
        _send(session, platform, sequence, folder)
        run = a_job(session, sequence, "sequence.process")
        a_job(session, sequence, "ingest.register", ("succeeded",))
        a_job(session, sequence, "labeler.fuse", ("lost", "succeeded"), run)
        a_job(session, sequence, "labeler.publish", ("succeeded",), run)
        _publish(session, platform, run, folder)
        brought = OwnerRun(owner.id, sequence.id, run.id, sha256(BAG).hexdigest(), len(BAG))
    return Played(platform, brought, made_by(platform, brought))


def added(session: Session, row: Row) -> Row:
    session.add(row)
    session.flush()
    return row


def a_job(
    session: Session, sequence: SequenceRow, kind: str, outcomes: tuple[str, ...] = (), run: Job | None = None
) -> Job:
    """A job that has succeeded, with an attempt for each outcome; a run where there is none."""
    job = Job(owner_id=sequence.owner_id, sequence_id=sequence.id, kind=kind, state="succeeded", attempt=len(outcomes))
    job.queue = kind.partition(".")[0] if outcomes else ""
    job.id = sha256(f"{kind}{outcomes}{run}".encode()).hexdigest()[:32]
    job.root_id = run.id if run else job.id
    added(session, job)
    for number, outcome in enumerate(outcomes, 1):
        added(session, JobAttempt(job_id=job.id, number=number, worker="here:1", outcome=outcome))
    return job


def _send(session: Session, platform: Platform, sequence: SequenceRow, folder: Path) -> None:
    digest = sha256(BAG).hexdigest()
    upload = Upload(owner_id=sequence.owner_id, purpose="recording", filename="chaos.mcap", length_bytes=len(BAG))
    upload.sha256, upload.declared_sha256, upload.state, upload.expires_ns = digest, digest, "consumed", now_ns()
    added(session, upload)
    storage_quota.reserve(session, sequence.owner_id, len(BAG), upload.id, "upload", GIB)
    path = upload_file(platform.settings, upload.id)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(BAG)
    added(session, recording_of(upload, sequence.id, "registered", _kept(session, platform, folder, BAG)))


def _publish(session: Session, platform: Platform, run: Job, folder: Path) -> None:
    label_set = LabelSet(sequence_id=run.sequence_id, job_id=run.id, recipe="r", parameters={}, code_version="1")
    label_set.frames = 2
    added(session, label_set)
    contents = {"report.json": b"{}", "labels/000000.pack": PACK}
    for name, content in contents.items():
        artefact = Artefact(label_set_id=label_set.id, name=name, media_type="text/plain", size_bytes=len(content))
        artefact.blob_sha256 = _kept(session, platform, folder, content)
        added(session, artefact)
        storage_quota.reserve(session, str(run.owner_id), len(content), label_set.id, "label set", GIB)
    for ordinal, (begin, end) in enumerate(((0, CUT), (CUT, len(PACK)))):
        frame = LabelledFrameRow(label_set_id=label_set.id, ordinal=ordinal, token=f"token-{ordinal}", stamp_ns=ordinal)
        frame.pack_id, frame.offset_bytes, frame.length_bytes = artefact.id, begin, end - begin
        frame.sha256 = sha256(PACK[begin:end]).hexdigest()
        added(session, frame)


def _kept(session: Session, platform: Platform, folder: Path, content: bytes) -> str:
    path = folder / sha256(content).hexdigest()
    path.write_bytes(content)
    return blobs.keep(session, platform.store, path).sha256
