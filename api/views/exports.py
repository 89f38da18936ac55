"""Exports as response bodies, and downloads of their files."""

from collections.abc import Sequence as Listing

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.errors import NotFoundError
from api.files import ServedFile
from api.schemas.sequences.exports import ArchiveItem, ArchiveKind, ExportItem
from api.views.jobs import coded_failure
from services.domain.exports.requests import counting_labels
from services.runtime.orm import Export, Job
from services.runtime.store.pack_reading import StoredFiles, archive_of, archive_pieces, file_pieces
from services.runtime.store.protocol import Store
from stone_files.archives import MEDIA_TYPES

FILE_TYPE = "application/octet-stream"
ARCHIVE_TYPES = tuple(MEDIA_TYPES.values())


def export_items(session: Session, sequence_id: str, exports: Listing[Export]) -> list[ExportItem]:
    """Return exports of one sequence as a list shows them."""
    labels = counting_labels(session, sequence_id)
    jobs = {job.id: job for job in session.scalars(select(Job).where(Job.id.in_([row.job_id for row in exports])))}
    return [_item(row, jobs[row.job_id], labels.id if labels else "") for row in exports]


def served_file(store: Store, stored: StoredFiles, path: str) -> ServedFile:
    """Return one file of an export. Raises `NotFoundError`."""
    files, read = stored.files, stored.reader(store)
    ordinal = files.ordinals.get(path)
    if ordinal is None:
        raise NotFoundError("file of this export", path)
    return ServedFile(
        size_bytes=int(files.sizes_bytes[ordinal]),
        sha256=files.digest(ordinal),
        media_type=FILE_TYPE,
        filename=path.rpartition("/")[2],
        read=lambda start, stop: file_pieces(files, ordinal, (start, stop), read),
        object_keys=(stored.object_keys[int(files.packs[ordinal])],),
    )


def served_archive(store: Store, stored: StoredFiles, kind: ArchiveKind, called: tuple[str, str]) -> ServedFile:
    """Return all files of an export as one archive, with its name (without the ending) and its sha256."""
    files, read = stored.files, stored.reader(store)
    archive = archive_of(files, kind)
    return ServedFile(
        size_bytes=archive.size_bytes,
        sha256=called[1],
        media_type=MEDIA_TYPES[kind],
        filename=f"{called[0]}.{kind}",
        read=lambda start, stop: archive_pieces(files, archive, (start, stop), read),
        object_keys=stored.object_keys,
    )


def archive_sha256_of(row: Export, kind: ArchiveKind) -> str:
    return row.tar_sha256 if kind == "tar" else row.zip_sha256


def _item(row: Export, job: Job, counting_id: str) -> ExportItem:
    return ExportItem.of(
        row,
        state="succeeded" if row.finished_ns is not None else job.state,
        is_stale=row.label_set_id != counting_id,
        archives=_archives(row),
        failure=coded_failure(job),
    )


def _archives(row: Export) -> list[ArchiveItem]:
    """Return the archives; none before there are files."""
    if row.finished_ns is None:
        return []
    return [
        ArchiveItem(format="tar", size_bytes=row.tar_bytes, sha256=row.tar_sha256),
        ArchiveItem(format="zip", size_bytes=row.zip_bytes, sha256=row.zip_sha256),
    ]
