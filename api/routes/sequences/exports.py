"""Routes of exports: request, list, download whole or file by file, delete.

**Conventions.** Equal requests are one export: a repetition returns the existing export, so an unchanged sequence is
not written twice. Archives are generated on the fly with stable bytes and sha256, and support ranges, so that a
download can resume. Only the owner of a sequence creates and deletes its exports. If the sequence is visible to others,
all signed-in users can download the finished ones.
"""

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from api import audit
from api.answers import refusals
from api.deps import Caller, Curator, PlatformDep, Reader, at_once
from api.etags import set_head
from api.files import answer_bytes, file_responses
from api.lists.answers import listed, model_response
from api.paging import Page, PageDep, page, place_of_page
from api.row_readers import by_row_readers
from api.schemas.base import IdPath
from api.schemas.sequences.exports import ArchiveKind, ExportAccepted, ExportFileItem, ExportItem, NewExportBody
from api.views.exports import (
    ARCHIVE_TYPES,
    FILE_TYPE,
    archive_sha256_of,
    export_items,
    served_archive,
    served_file,
)
from api.views.jobs import job_items
from api.visible import export_of, exports_shown_to, readable_export, sequence_of, shown_sequence
from services.domain.exports.requests import delete_export, start_export
from services.runtime.orm import Export, SequenceRow
from services.runtime.platform import Platform
from services.runtime.store.pack_reading import StoredFiles, locate_export, stored_files
from stone_files.archives import MOST_NAME, NAME

router = APIRouter(prefix="/sequences/{sequence_id}/exports", tags=["exports"])
FilePath = Annotated[str, Path(pattern=f"^{NAME.pattern}$", max_length=MOST_NAME, examples=["sha256sum.txt"])]
Kind = Annotated[ArchiveKind, Query(alias="format", description="Format of the archive: tar or zip.")]
FILE = file_responses(FILE_TYPE)
ARCHIVE = file_responses(*ARCHIVE_TYPES)


@dataclass(frozen=True)
class ExportPath:
    """An export of a sequence, by their ids."""

    sequence_id: IdPath
    export_id: IdPath


AtExport = Annotated[ExportPath, Depends(at_once(ExportPath))]


@router.post("", status_code=202, responses=refusals(403, 404, 409))
def create_export(
    sequence_id: IdPath, body: NewExportBody, caller: Curator, platform: PlatformDep, response: Response
) -> ExportAccepted:
    """Export the active labels; a failed export is tried again."""
    with platform.database.transaction() as session:
        sequence = sequence_of(session, caller, sequence_id)
        export, job = start_export(session, sequence, body.format)
        facts = {"format": body.format, "sequence_id": sequence.id, "job_id": job.id}
        audit.record(session, caller, "export.create", export.id, facts=facts)
        items = export_items(session, sequence.id, [export])
        shown = ExportAccepted(export=items[0], job=job_items(session, [job])[0])
    return set_head(response, shown, location=f"/api/v1/sequences/{sequence_id}/exports/{export.id}")


@router.get("", response_model=Page[ExportItem], responses=listed(404))
@by_row_readers
def list_exports(
    sequence_id: IdPath, caller: Reader, platform: PlatformDep, query: PageDep, request: Request
) -> Response:
    """List the exports of a sequence, newest first; includes stale exports."""
    with platform.database.lookups() as session:
        exports = page(session, exports_shown_to(session, caller, sequence_id), Export.id.desc(), query)
        shown = Page[ExportItem](items=export_items(session, sequence_id, exports.rows), next=exports.next)
    return model_response(request, shown)


@router.get("/{export_id}", summary="Show an export", responses=refusals(404))
def show_export(at: AtExport, caller: Reader, platform: PlatformDep) -> ExportItem:
    """Show an export: progress, sources and size."""
    with platform.database.reading() as session:
        export = readable_export(session, caller, at.sequence_id, at.export_id)
        return export_items(session, export.sequence_id, [export])[0]


@router.delete("/{export_id}", name="delete_export", status_code=204, responses=refusals(403, 404))
def remove_export(at: AtExport, caller: Curator, platform: PlatformDep) -> None:
    """Delete an export and release its storage; its job is stopped."""
    with platform.database.transaction() as session:
        export = export_of(session, caller, at.sequence_id, at.export_id)
        facts = {"format": export.format, "sequence_id": export.sequence_id}
        audit.record(session, caller, "export.delete", export.id, facts=facts)
        delete_export(session, export)


@router.get(
    "/{export_id}/files",
    summary="List the files of an export in the order of the archives",
    responses=refusals(404, 409),
)
def list_export_files(at: AtExport, caller: Reader, platform: PlatformDep, query: PageDep) -> Page[ExportFileItem]:
    """List the files of an export in the order of the archives: by name, the checksums last."""
    stored, _, _ = _finished(platform, caller, at)
    files = stored.files
    places, following = place_of_page(len(files), query)
    items = [
        ExportFileItem(path=files.names[i], size_bytes=int(files.sizes_bytes[i]), sha256=files.digest(i))
        for i in places
    ]
    return Page[ExportFileItem](items=items, next=following)


@router.get("/{export_id}/files/{path:path}", response_class=Response, responses=FILE | refusals(409))
@router.head(
    "/{export_id}/files/{path:path}",
    response_class=Response,
    responses=FILE | refusals(409),
    name="describe_export_file",
    description="Show size and checksum of a file.",
)
def download_export_file(
    at: AtExport, path: FilePath, caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Download one file of an export; `sha256sum.txt` contains the checksums of all others."""
    stored, _, _ = _finished(platform, caller, at)
    return answer_bytes(request, served_file(platform.store, stored, path))


@router.get("/{export_id}/archive", response_class=Response, responses=ARCHIVE | refusals(409))
@router.head(
    "/{export_id}/archive",
    response_class=Response,
    responses=ARCHIVE | refusals(409),
    name="describe_export_archive",
    description="Show size and checksum of an archive.",
)
def download_export_archive(
    at: AtExport, caller: Reader, platform: PlatformDep, request: Request, kind: Kind = "tar"
) -> Response:
    """Download all files of an export in one archive; supports ranges, and the ETag is the sha256."""
    stored, export, sequence = _finished(platform, caller, at)
    called = (f"{sequence.name}-{export.format}", archive_sha256_of(export, kind))
    return answer_bytes(request, served_archive(platform.store, stored, kind, called))


def _finished(platform: Platform, caller: Caller, at: ExportPath) -> tuple[StoredFiles, Export, SequenceRow]:
    """Return the files of an export. Raises `NotFoundError`, `export_unfinished`."""
    with platform.database.reading() as session:
        sequence = shown_sequence(session, caller, at.sequence_id)
        export = readable_export(session, caller, sequence.id, at.export_id)
        located = locate_export(session, export)
    return stored_files(platform.store, located), export, sequence
