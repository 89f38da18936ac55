"""Imports of published datasets: asked for with a complete upload, begun again, deleted; cancelled as any run is.

**Conventions.** Each function is part of the caller's transaction. The run's row is locked first, then the import's,
then what belongs to the owner. The tar's bytes are counted against the owner under its upload's id until the import has
ended well or was deleted; what was made of it stays then, and is deleted sequence by sequence.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from typing import Any, Literal

from sqlalchemy import delete
from sqlalchemy.orm import Session

from services.domain.imports.errors import SplitsForbiddenError
from services.domain.sequences.restart import RESTARTS
from services.runtime.access import storage_quota
from services.runtime.access.roles import allows
from services.runtime.code_version import code_version
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.control import cancel, terminate
from services.runtime.jobs.enqueue import enqueue_run
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import TERMINAL, Context, JobSpec
from services.runtime.orm import DatasetImport, ImportedFile, Job, User, new_id
from services.runtime.telemetry.origins import link_to
from services.runtime.uploads import consume

IMPORT = "dataset.import"
KEEP_DATASET = "ingest.keep_dataset"
INDEX = "labeler.import_index"
SCENE = "labeler.import_scene"
PUBLISH_IMPORT = "labeler.import_publish"
PURPOSE = "dataset"
LONGEST_NAME = 100
Existing = Literal["refuse", "add"]
Meaning = Literal["free", "T", "P", "N", "unobserved"]


@dataclass(frozen=True)
class StatedClasses:
    """What the numbers (0 to 255) of a label set mean, as its owner states it; `name` is the set's."""

    name: str
    meanings: Mapping[int, Meaning]

    def as_record(self) -> dict[str, Any]:
        return {"name": self.name, "classes": {str(number): self.meanings[number] for number in sorted(self.meanings)}}


@dataclass(frozen=True)
class ImportedFacts:
    """What is said of every sequence that an import makes; of one that stands already nothing is changed."""

    environment: str = ""
    illumination: str = ""
    region: str = ""
    platform: str = ""
    is_public: bool = False


@dataclass(frozen=True)
class NewImport:
    """The import of the dataset in a complete upload of a tar, called `name`, or else as its file is.

    Without `classes` its labels are numbered as ours. A scene that is called as a sequence of the owner's is refused,
    or (`existing` "add") its labels become another label set of that sequence. With `sets_splits` the draft splits
    follow those of the dataset.
    """

    upload_id: str
    name: str = ""
    classes: StatedClasses | None = None
    existing: Existing = "refuse"
    sets_splits: bool = False
    facts: ImportedFacts = ImportedFacts()


def start_import(session: Session, owner: User, new: NewImport) -> tuple[DatasetImport, Job]:
    """Use up the owner's upload: its import, and the run that does it.

    Raises `SplitsForbiddenError`, what `uploads.consume` raises, `QueueDrainingError`.
    """
    if new.sets_splits and not allows(owner.role, ("administrator",)):
        raise SplitsForbiddenError
    upload = consume(session, new.upload_id, owner.id, PURPOSE)
    link_to(upload.traceparent)
    imported = DatasetImport(
        id=new_id(),
        owner_id=owner.id,
        upload_id=upload.id,
        name=(new.name or upload.filename.removesuffix(".tar"))[:LONGEST_NAME],
        sha256=upload.sha256,
        size_bytes=upload.length_bytes,
        classes=new.classes.as_record() if new.classes else None,
        existing=new.existing,
        sets_splits=new.sets_splits,
        facts=asdict(new.facts),
    )
    run = _begun(session, imported)
    session.add(imported)
    session.flush()
    return imported, run


def begin_import_again(session: Session, imported: DatasetImport, reason: str, restarts: int = 0) -> Job:
    """A new run in the place of this one, which ends cancelled where it has not ended; nothing of it is used.

    Raises `QueueDrainingError`, and `JobStateError` where it has ended well.
    """
    old = lock_run(session, imported.job_id)
    if old.state == "succeeded":
        raise JobStateError(old.id, old.state, "begun again", "other")
    if old.state not in TERMINAL:
        terminate(session, old.id, reason)
    session.execute(delete(ImportedFile).where(ImportedFile.import_id == imported.id))
    imported.scenes = None
    run = _begun(session, imported, restarts)
    session.flush()
    return run


def delete_import(session: Session, imported: DatasetImport) -> None:
    """Delete the import, whether it has ended or not, and give its tar's bytes back; its sequences stay."""
    with suppress(JobStateError):  # it has ended
        cancel(session, imported.job_id, "its import was deleted")
    session.execute(delete(DatasetImport).where(DatasetImport.id == imported.id))
    storage_quota.release(session, imported.upload_id, "import deleted")


def _begun(session: Session, imported: DatasetImport, restarts: int = 0) -> Job:
    """Raises `QueueDrainingError`."""
    run = enqueue_run(session, IMPORT, [JobSpec(KEEP_DATASET)], Context(imported.owner_id))
    run.arguments = {"import_id": imported.id, "code_version": code_version("imports"), RESTARTS: restarts}
    imported.job_id = run.id
    return run
