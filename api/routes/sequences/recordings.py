"""Routes of a sequence's recordings: create from a complete upload, list, delete."""

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Curator, PlatformDep, Reader, at_once
from api.etags import set_head
from api.files import answer_file, file_responses
from api.paging import Page, PageDep, page
from api.schemas.base import IdPath
from api.schemas.sequences.recordings import (
    NewRecordingBody,
    RecordingAccepted,
    RecordingDetail,
    RecordingItem,
    RecordingRoots,
)
from api.views.jobs import job_items
from api.views.preview_files import PREVIEW_TYPES, PreviewName, recording_preview
from api.views.recordings import recording_detail, recording_item
from api.visible import recording_of, sequence_of
from services.domain.sequences.recordings import add_in_place, add_recording, remove_recording
from services.runtime.orm import Recording

router = APIRouter(prefix="/sequences/{sequence_id}/recordings", tags=["recordings"])
roots_router = APIRouter(prefix="/recording-roots", tags=["recordings"])


@dataclass(frozen=True)
class RecordingPreview:
    """A preview of a recording, by its name."""

    sequence_id: IdPath
    recording_id: IdPath
    name: PreviewName


@router.post("", status_code=202, responses=refusals(403, 404, 409, 422))
def create_recording(
    sequence_id: IdPath, body: NewRecordingBody, caller: Curator, platform: PlatformDep, response: Response
) -> RecordingAccepted:
    """Create a recording from your complete uploads; a job reads and keeps it. An upload can be used once.

    The files of one bag are accepted all together or not at all. A bag `in_place` is read where it lies; the job checks
    that it exists.
    """
    with platform.database.transaction() as session:
        sequence, facts = sequence_of(session, caller, sequence_id), {"sequence_id": sequence_id}
        if body.in_place is not None:
            source = body.in_place.place()
            recording, job = add_in_place(session, platform.settings.in_place, sequence, source)
            facts |= {"place": str(source)}
        else:
            recording, job = add_recording(session, sequence, body.received(), caller.user_id)
        audit.record(session, caller, "recording.add", recording.id, facts=facts)
        shown = RecordingAccepted(recording=recording_item(recording), job=job_items(session, [job])[0])
    return set_head(response, shown, location=f"/api/v1/sequences/{sequence_id}/recordings/{recording.id}")


@router.get("", responses=refusals(404))
def list_recordings(sequence_id: IdPath, caller: Reader, platform: PlatformDep, query: PageDep) -> Page[RecordingItem]:
    """List the recordings of a sequence, oldest first."""
    with platform.database.reading() as session:
        sequence = sequence_of(session, caller, sequence_id)
        statement = select(Recording).where(Recording.sequence_id == sequence.id)
        return page(session, statement, Recording.id, query).shown(recording_item)


@router.get("/{recording_id}", responses=refusals(404))
def show_recording(sequence_id: IdPath, recording_id: IdPath, caller: Reader, platform: PlatformDep) -> RecordingDetail:
    """Show a recording with its inspection."""
    with platform.database.reading() as session:
        return recording_detail(session, recording_of(session, caller, sequence_id, recording_id))


@router.get(
    "/{recording_id}/previews/{name}",
    summary="Download a preview of a recording",
    response_class=Response,
    responses=file_responses(*PREVIEW_TYPES),
)
def download_recording_preview(
    at: Annotated[RecordingPreview, Depends(at_once(RecordingPreview))],
    caller: Reader,
    platform: PlatformDep,
    request: Request,
) -> Response:
    """Return `cameras.jpg`, `sweep.png`, `track.png`, `quality.html` (page) or `quality.json` (for programs)."""
    with platform.database.reading() as session:
        recording = recording_of(session, caller, at.sequence_id, at.recording_id)
        file = recording_preview(session, recording, at.name)
    return answer_file(request, platform.store, file)


@router.delete("/{recording_id}", status_code=204, responses=refusals(403, 404, 409))
def delete_recording(sequence_id: IdPath, recording_id: IdPath, caller: Curator, platform: PlatformDep) -> None:
    """Delete a recording and release its storage; existing labels stay. A recording that a run is reading cannot be
    deleted.
    """
    with platform.database.transaction() as session:
        recording = recording_of(session, caller, sequence_id, recording_id)
        remove_recording(session, recording)
        audit.record(session, caller, "recording.delete", recording_id, facts={"sequence_id": sequence_id})


@roots_router.get("", responses=refusals(403))
def list_recording_roots(caller: Curator, platform: PlatformDep) -> RecordingRoots:
    """List the roots below which a curator can name bags in place; an administrator configures them."""
    return RecordingRoots(roots=platform.settings.in_place.roots)
