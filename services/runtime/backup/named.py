"""What a state of the database names outside of it: blobs, the work of runs that are not over, uploads under way.

**Conventions.** Asked within the snapshot's own transaction, except for what may be much: blobs and slabs (bytes under
way that lie in the store) are read from the rows that were written. Of uploads only those in the folder are told. A run
is over when it succeeded, or failed so long ago that its work is not kept (`collection`).
"""

from dataclasses import dataclass

from sqlalchemy import Connection, and_, or_, select

from services.runtime.collection import KEPT_FAILED_NS
from services.runtime.orm import Job, RecordingFile, Submission, Upload
from services.runtime.orm.base import now_ns
from services.runtime.uploads.slab_rows import STORE


@dataclass(frozen=True)
class NamedUpload:
    """An upload whose bytes lie in the folder only; `sha256` is empty until all of them are there."""

    id: str
    sha256: str


@dataclass(frozen=True)
class Named:
    """Ids of the runs whose work is needed, and the uploads whose bytes are."""

    runs: frozenset[str]
    uploads: tuple[NamedUpload, ...]


def named_by(connection: Connection) -> Named:
    return Named(frozenset(_runs(connection)), tuple(_uploads(connection)))


def _runs(connection: Connection) -> list[str]:
    kept_ns = now_ns() - KEPT_FAILED_NS
    needed = or_(Job.finished_ns.is_(None), (Job.state != "succeeded") & (Job.finished_ns > kept_ns))
    return list(connection.scalars(select(Job.id).where(Job.id == Job.root_id, needed)))


def _uploads(connection: Connection) -> list[NamedUpload]:
    """Those under way or whole, and those of which whoever used them has no blob yet."""
    used = Upload.state == "consumed"
    recorded = select(RecordingFile.upload_id).where(RecordingFile.blob_sha256.is_(None))
    submitted = select(Submission.upload_id).where(Submission.blob_sha256.is_(None))
    needed = or_(
        Upload.state.in_(("open", "complete")),
        and_(used, Upload.purpose.not_in(("recording", "submission"))),
        and_(used, Upload.purpose == "recording", Upload.id.in_(recorded)),
        and_(used, Upload.purpose == "submission", Upload.id.in_(submitted)),
    )
    found = connection.execute(
        select(Upload.id, Upload.sha256).where(Upload.place != STORE, needed).order_by(Upload.id)
    )
    return [NamedUpload(upload_id, sha256) for upload_id, sha256 in found]
