"""Imports of published datasets: from a complete upload or in place, restarted, deleted; cancelled like any run.

**Conventions.** Each function is part of the caller's transaction. Locks are taken in this order: run, import, owner's
rows. The tar's bytes count against the owner under its upload's id until the import has succeeded or was deleted. The
imported sequences stay then, and are deleted one by one. Bytes in place are not counted.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from hashlib import sha256
from typing import Any, Literal

from sqlalchemy import Select, delete, select
from sqlalchemy.orm import Session

from services.domain.sequences.restart import MOST_RESTARTS, RESTARTS, RestartedTooOftenError, code_changed
from services.runtime.access import storage_quota
from services.runtime.access.roles import allows
from services.runtime.code_version import code_version
from services.runtime.in_place.datasets import requested_dataset
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.control import cancel, terminate
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobCancelledError, JobStateError, QueueDrainingError
from services.runtime.jobs.specs import TERMINAL, Attempt, Context, JobSpec
from services.runtime.orm import DatasetImport, ImportedFile, Job, SequenceRow, User, new_id
from services.runtime.platform import Platform
from services.runtime.telemetry.origins import link_to
from services.runtime.uploads import consume
from stone_base.errors import splits_forbidden
from stone_datasets.stated_layout import UNSTATED, StatedLayout
from stone_recordings.sync.stored_recording import RecordingPlace

IMPORT = "dataset.import"
KEEP_DATASET = "ingest.keep_dataset"
INDEX = "labeler.import_index"
SCENE = "labeler.import_scene"
PUBLISH_IMPORT = "labeler.import_publish"
PURPOSE = "dataset"
LONGEST_NAME = 100
NOWHERE = InPlaceSettings()
Existing = Literal["refuse", "add"]
Meaning = Literal["free", "T", "P", "N", "unobserved"]


@dataclass(frozen=True)
class StatedClasses:
    """The meaning of a label set's numbers (0 to 255), as stated by its owner; `name` is the set's name."""

    name: str
    meanings: Mapping[int, Meaning]

    def as_record(self) -> dict[str, Any]:
        return {"name": self.name, "classes": {str(number): self.meanings[number] for number in sorted(self.meanings)}}


@dataclass(frozen=True)
class ImportedFacts:
    """Attributes of every sequence that an import creates; existing sequences are not changed."""

    environment: str = ""
    illumination: str = ""
    region: str = ""
    platform: str = ""
    is_public: bool = False


@dataclass(frozen=True)
class NewImport:
    """The import of a dataset in a complete upload (tar or zip) or at an `archive_place`; `name` defaults to the file's
    name.

    - `classes`: numbering of the labels (default: the platform's)
    - `stated`: layout and grid, if they are not to be detected
    - `existing`: a scene with the name of one of the owner's sequences is refused, or ("add") its labels become another
      label set of that sequence
    - `sets_splits`: the draft splits follow the dataset's splits
    """

    upload_id: str = ""
    name: str = ""
    classes: StatedClasses | None = None
    existing: Existing = "refuse"
    sets_splits: bool = False
    facts: ImportedFacts = ImportedFacts()
    archive_place: RecordingPlace | None = None
    stated: StatedLayout = UNSTATED


def start_import(
    session: Session, owner: User, new: NewImport, in_place: InPlaceSettings = NOWHERE
) -> tuple[DatasetImport, Job]:
    """Consume the owner's upload, or record the place; return its import and the run.

    The run checks whether the place contains a file, on a machine that has the root. Raises `splits_forbidden`, what
    `uploads.consume` and `requested_dataset` raise, `QueueDrainingError`.
    """
    if new.sets_splits and not allows(owner.role, ("administrator",)):
        raise splits_forbidden()
    archive = (
        _archive_of_upload(session, new, owner)
        if new.archive_place is None
        else _archive_of_place(in_place, new.archive_place)
    )
    imported = DatasetImport(
        id=new_id(),
        owner_id=owner.id,
        name=(new.name or archive.filename.removesuffix(".tar").removesuffix(".zip"))[:LONGEST_NAME],
        upload_id=archive.upload_id,
        place=archive.place_record,
        sha256=archive.sha256,
        size_bytes=archive.size_bytes,
        classes=new.classes.as_record() if new.classes else None,
        stated=new.stated.as_record(),
        existing=new.existing,
        sets_splits=new.sets_splits,
        facts=asdict(new.facts),
    )
    run = _begun(session, imported)
    session.add(imported)
    session.flush()
    return imported, run


@dataclass(frozen=True)
class _Archive:
    """Columns of an import's row that describe its archive."""

    filename: str
    sha256: str
    size_bytes: int
    upload_id: str | None = None
    place_record: dict[str, Any] | None = None


def _archive_of_upload(session: Session, new: NewImport, owner: User) -> _Archive:
    upload = consume(session, new.upload_id, owner.id, PURPOSE)
    link_to(upload.traceparent)
    return _Archive(upload.filename, upload.sha256, upload.length_bytes, upload.id)


def _archive_of_place(in_place: InPlaceSettings, requested: RecordingPlace) -> _Archive:
    """Return the archive at a place; its file is not read yet, so the hash is that of the place."""
    resolved = requested_dataset(in_place, requested)
    return _Archive(resolved.name, sha256(str(resolved).encode()).hexdigest(), 0, place_record=resolved.as_record())


def begin_import_again(session: Session, imported: DatasetImport, reason: str, restarts: int = 0) -> Job:
    """Replace this run with a new one; the old run is cancelled unless it has ended, and its results are not used.

    Raises `QueueDrainingError`, and `JobStateError` if the import has succeeded.
    """
    old = lock_run(session, imported.job_id)
    if old.state == "succeeded":
        raise JobStateError(old.id, old.state, "begun again", "other")
    if old.state not in TERMINAL:
        terminate(session, old.id, reason)
    session.execute(delete(ImportedFile).where(ImportedFile.import_id == imported.id))
    imported.scenes = imported.left_out = None
    run = _begun(session, imported, restarts)
    session.flush()
    return run


def delete_import(session: Session, imported: DatasetImport) -> None:
    """Delete the import in any state, and release its tar's bytes; its sequences stay."""
    with suppress(JobStateError):  # the job has ended
        cancel(session, imported.job_id, "its import was deleted")
    session.execute(delete(DatasetImport).where(DatasetImport.id == imported.id))
    if imported.upload_id is not None:
        storage_quota.release(session, imported.upload_id, "import deleted")
    storage_quota.release(session, imported.id, "import deleted")


def _begun(session: Session, imported: DatasetImport, restarts: int = 0) -> Job:
    """Queue and return the import's run. Raises `QueueDrainingError`."""
    run = enqueue_run(session, IMPORT, [JobSpec(KEEP_DATASET)], Context(imported.owner_id))
    run.arguments = {"import_id": imported.id, "code_version": code_version("imports"), RESTARTS: restarts}
    imported.job_id = run.id
    return run


# Progress of an import, scene by scene.


@dataclass(frozen=True)
class SceneProgress:
    """A scene and the job that imports it.

    `state` is the job's; `sequence_id` is set once the whole import has succeeded, unless the sequence was deleted.
    """

    ordinal: int
    name: str
    frames: int
    splits: tuple[str, ...]
    state: str
    sequence_id: str | None


@dataclass(frozen=True)
class ImportProgress:
    """An import, its run, and its scenes (none before the index exists)."""

    imported: DatasetImport
    run: Job
    scenes: tuple[SceneProgress, ...]

    @property
    def done(self) -> int:
        """The number of finished scenes."""
        return sum(scene.state == "succeeded" for scene in self.scenes)


def place_of(imported: DatasetImport) -> RecordingPlace | None:
    """Return the place of an archive that is read in place."""
    return None if imported.place is None else RecordingPlace.of_record(imported.place)


def progress_of(session: Session, imported: DatasetImport) -> ImportProgress:
    """Return the import's progress."""
    run, records = session.get_one(Job, imported.job_id), imported.scenes or []
    states = _states(session, run.id)
    ids = [record["sequence_id"] for record in records if "sequence_id" in record]
    alive = set(
        session.scalars(select(SequenceRow.id).where(SequenceRow.id.in_(ids), SequenceRow.deleted_ns.is_(None)))
    )
    scenes = (
        SceneProgress(
            ordinal,
            record["name"],
            record["frames"],
            tuple(record["splits"]),
            states.get(ordinal, "queued"),
            record.get("sequence_id") if record.get("sequence_id") in alive else None,
        )
        for ordinal, record in enumerate(records)
    )
    return ImportProgress(imported, run, tuple(scenes))


def _states(session: Session, root_id: str) -> Mapping[int, str]:
    jobs = select(Job.arguments, Job.state).where(Job.root_id == root_id, Job.kind == SCENE)
    return {arguments["scene"]: state for arguments, state in session.execute(jobs)}


# The run of an import as seen by its stages. As in `services/domain/sequences/restart.py`, one import is made by one
# version of the code: a run that another version started ends, and a new run of the same request replaces it. The same
# happens if its files were deleted meanwhile.


REMEDY = "Try again later"
GONE = "its import was deleted, or another run imports the dataset"


def import_of_attempt(platform: Platform, attempt: Attempt) -> DatasetImport:
    """Return the attempt's import, whose run this version of the code started.

    Raises `JobCancelledError` if the import was deleted, or if another version started the run, which is then
    restarted; `code_changed` if it cannot be restarted.
    """
    with platform.database.reading() as session:
        begun = session.get_one(Job, attempt.root_id).arguments["code_version"]
        imported = _require_import(session, _made_by(attempt))
    if begun == code_version("imports"):
        return imported
    try:
        begin_run_again(platform, attempt, f"the platform was upgraded to code version {code_version('labels')}")
    except (QueueDrainingError, RestartedTooOftenError) as error:
        raise code_changed((begun, code_version("imports")), error, REMEDY) from error
    raise JobCancelledError(f"its run was started by version {begun}; another run imports the dataset")


def begin_run_again(platform: Platform, attempt: Attempt, reason: str) -> None:
    """Replace the attempt's run, unless it has ended, is being cancelled, or its import was deleted.

    If several jobs call it concurrently, only one starts a run. Raises `QueueDrainingError`, `RestartedTooOftenError`.
    """
    with platform.database.transaction() as session:
        old = lock_run(session, attempt.root_id)
        imported = session.scalars(_made_by(attempt).with_for_update(key_share=True)).one_or_none()
        if imported is None or old.state in TERMINAL or old.cancel_reason:
            return
        restarts = old.arguments.get(RESTARTS, 0) + 1
        if restarts > MOST_RESTARTS:
            raise RestartedTooOftenError(MOST_RESTARTS)
        new = begin_import_again(session, imported, reason, restarts)
        old.cancel_reason = f"{reason}; job {new.id} imports the dataset instead"


def kept_import(session: Session, attempt: Attempt) -> DatasetImport:
    """Return the import, locked until the end of the transaction. Raises `JobCancelledError`."""
    return _require_import(session, _made_by(attempt).with_for_update(key_share=True))


def _require_import(session: Session, statement: Select[DatasetImport]) -> DatasetImport:
    imported = session.scalars(statement.execution_options(populate_existing=True)).one_or_none()
    if imported is None:
        raise JobCancelledError(GONE)
    return imported


def _made_by(attempt: Attempt) -> Select[DatasetImport]:
    return select(DatasetImport).where(DatasetImport.job_id == attempt.root_id)
