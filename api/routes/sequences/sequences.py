"""Routes of sequences: create, list, change, pin a calibration, delete.

**Conventions.** The ETag is the sequence's revision: it moves when what can be changed has changed, not when a job of
it moves on. PATCH and DELETE ask for it; PUT of the calibration honours it.
"""

from collections.abc import Mapping
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Curator, Looker, PlatformDep, at_once
from api.errors import ApiError
from api.etags import etag, require_match, set_head
from api.lists.answers import SequenceFilters, list_response, listed, sequence_rows
from api.paging import Page, PageDep
from api.row_readers import by_row_readers
from api.schemas.base import IdPath
from api.schemas.sequences.sequences import (
    NewSequenceBody,
    PinCalibrationBody,
    SequenceChangesBody,
    SequenceDetail,
    SequenceItem,
)
from api.views.sequences import sequence_detail, sequence_facts, shown_sequence_detail
from api.visible import calibration_of, hiding, sequence_of
from services.domain.datasets.splits import lock_splits
from services.domain.sequences.processing import PROCESS, delete_sequence, lock_sequence
from services.runtime.access.errors import name_taken
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Job, LabelSet, SequenceRow

router = APIRouter(prefix="/sequences", tags=["sequences"])


@router.post("", summary="Create a sequence", status_code=201, responses=refusals(409))
def create_sequence(
    body: NewSequenceBody, caller: Curator, platform: PlatformDep, response: Response
) -> SequenceDetail:
    """Create a sequence; its name must be unique among yours."""
    with platform.database.transaction() as session:
        sequence = SequenceRow(owner_id=caller.user_id, **body.model_dump())
        session.add(sequence)
        _flush_named(session, body.name)
        audit.record(session, caller, "sequence.create", sequence.id, facts={"name": sequence.name})
        shown = sequence_detail(session, sequence, caller)
    return set_head(response, shown, tag=shown.revision, location=f"/api/v1/sequences/{shown.id}")


@router.get("", response_model=Page[SequenceItem], responses=listed())
@by_row_readers
def list_sequences(
    request: Request,
    caller: Looker,
    platform: PlatformDep,
    query: PageDep,
    filters: Annotated[SequenceFilters, Depends(at_once(SequenceFilters))],
) -> Response:
    """List your sequences and the public ones, newest first; administrators see all sequences."""
    with platform.database.lookups() as session:
        rows, following = sequence_rows(session, caller, filters, query)
        return list_response(request, sequence_facts(session, rows), following)


@router.get(
    "/{sequence_id}",
    summary="Show a sequence with its newest run, its newest labels and their files",
    response_model=SequenceDetail,
    responses=refusals(404),
)
@by_row_readers
def show_sequence(sequence_id: IdPath, caller: Looker, platform: PlatformDep) -> Response:
    """Show a sequence with its newest run, its newest labels and their files."""
    with platform.database.lookups() as session:
        shown = shown_sequence_detail(session, caller, sequence_id)
    headers = {"ETag": etag(shown.revision)}
    return Response(shown.model_dump_json(), headers=headers, media_type="application/json")


@router.patch("/{sequence_id}", responses=refusals(404, 409, 412, 428))
def change_sequence(
    sequence_id: IdPath,
    body: SequenceChangesBody,
    caller: Curator,
    platform: PlatformDep,
    request: Request,
    response: Response,
) -> SequenceDetail:
    """Change the attributes of a sequence; missing and null keys stay."""
    with platform.database.transaction() as session:
        if body.is_public:
            lock_splits(
                session
            )  # first, as for saving splits, so that of two concurrent requests one sees the other's change
        sequence = lock_sequence(session, sequence_of(session, caller, sequence_id).id)
        require_match(request, sequence.revision)
        changes = {key: value for key, value in body if value is not None and value != getattr(sequence, key)}
        if "name" in changes:
            _refuse_renaming(session, sequence)
        if changes.get("is_public"):
            _refuse_revealing_truth(session, sequence)
        _change(sequence, changes)
        _flush_named(session, sequence.name)
        audit.record(session, caller, "sequence.change", sequence.id, facts=changes)
        shown = sequence_detail(session, sequence, caller)
    return set_head(response, shown, tag=shown.revision)


@router.put(
    "/{sequence_id}/calibration",
    summary="Assign a calibration to a sequence",
    responses=refusals(404, 412),
)
def assign_calibration(
    sequence_id: IdPath,
    body: PinCalibrationBody,
    caller: Curator,
    platform: PlatformDep,
    request: Request,
    response: Response,
) -> SequenceDetail:
    """Assign the calibration for later runs; existing labels keep theirs."""
    with platform.database.transaction() as session:
        sequence = lock_sequence(session, sequence_of(session, caller, sequence_id).id)
        if "if-match" in request.headers:
            require_match(request, sequence.revision)
        calibration = calibration_of(session, caller, body.calibration_id)
        if sequence.calibration_id != calibration.id:
            _change(sequence, {"calibration_id": calibration.id})
            audit.record(session, caller, "sequence.calibrate", sequence.id, facts={"calibration_id": calibration.id})
        session.flush()
        shown = sequence_detail(session, sequence, caller)
    return set_head(response, shown, tag=shown.revision)


@router.delete("/{sequence_id}", name="delete_sequence", status_code=204, responses=refusals(404, 412, 428))
def remove_sequence(sequence_id: IdPath, caller: Curator, platform: PlatformDep, request: Request) -> None:
    """Delete a sequence with its recordings and labels; its jobs are stopped. Deletion is permanent."""
    with platform.database.transaction() as session:
        sequence = lock_sequence(session, sequence_of(session, caller, sequence_id).id)
        require_match(request, sequence.revision)
        audit.record(session, caller, "sequence.delete", sequence.id, facts={"name": sequence.name})
        delete_sequence(session, sequence)


def _change(sequence: SequenceRow, changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        setattr(sequence, key, value)
    sequence.revision += 1 if changes else 0


def _refuse_renaming(session: Session, sequence: SequenceRow) -> None:
    """Refuse a new name if frame tokens already contain the old one. Raises `conflict`."""
    labels = select(LabelSet.id).where(LabelSet.sequence_id == sequence.id)
    runs = select(Job.id).where(Job.sequence_id == sequence.id, Job.kind == PROCESS, Job.state.not_in(TERMINAL))
    if session.scalar(labels.limit(1)) or session.scalar(runs.limit(1)):
        raise ApiError(
            "conflict", "a sequence with labels or a run cannot be renamed, because its frame tokens contain its name"
        )


def _refuse_revealing_truth(session: Session, sequence: SequenceRow) -> None:
    """Refuse to make hidden ground truth public. Raises `hidden_truth`."""
    if where := hiding(session, sequence.id):
        raise ApiError(
            "hidden_truth",
            f"sequence {sequence.name!r} is {where}: if it were public, anyone could download the labels that score "
            "entries. Make another sequence public, or remove this sequence from test before you publish a version",
        )


def _flush_named(session: Session, name: str) -> None:
    """Flush; the unique index gives a name to one of two concurrent requests. Raises `name_taken`."""
    try:
        session.flush()
    except IntegrityError:
        raise name_taken("sequence", name) from None
