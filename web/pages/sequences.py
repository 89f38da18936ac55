"""The list of sequences, with picture, status and content each, and the page that creates new ones.

**Conventions.** An empty field of the filters is none. A visitor and everybody else see what the API's list shows them.
"""

from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select

from api.callers import Curator, Looker
from api.deps import Caller, PlatformDep
from api.paging import PageQuery
from api.paging import page as paged
from api.routes.sequences.sequences import Prefix, SequenceFilters
from api.schemas.base import LineQuery
from api.schemas.sequences.sequences import SequenceItem
from api.views.calibrations import calibration_item
from api.views.sequences import sequence_items
from api.visible import sequences_shown_to, theirs
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import CalibrationRow, SequenceRow
from stone.splits.surroundings import ENVIRONMENTS, ILLUMINATIONS
from web.rendering import page

router = APIRouter(prefix="/sequences")
SHOWN = 24
MOST_CALIBRATIONS = 200
Cursor = Annotated[str | None, Query(max_length=512)]
Whose = Annotated[Literal["", "mine"], Query(description="everybody's that one may see, or one's own")]


@dataclass(frozen=True)
class SequenceFilterForm:
    """The fields of the form above the list."""

    name: Prefix = None
    environment: LineQuery = None
    illumination: LineQuery = None
    whose: Whose = ""

    @property
    def is_narrow(self) -> bool:
        return any((self.name, self.environment, self.illumination, self.whose))

    def filters(self, caller: Caller) -> SequenceFilters:
        return SequenceFilters(
            environment=self.environment or None,
            illumination=self.illumination or None,
            name=self.name or None,
            owner_id=caller.user_id if self.whose and caller.user_id else None,
        )


@router.get("")
def list_sequences(
    request: Request,
    caller: Looker,
    platform: PlatformDep,
    asked: Annotated[SequenceFilterForm, Depends()],
    cursor: Cursor = None,
) -> HTMLResponse:
    """The newest first; while something of a page is being made, the page says how it goes on."""
    narrowed = asked.filters(caller).narrowed(sequences_shown_to(caller))
    with platform.database.reading() as session:
        found = paged(session, narrowed, SequenceRow.id.desc(), PageQuery(cursor or None, SHOWN))
        items = sequence_items(session, found.rows, caller)
    shown = [(item, *status_in_words(item)) for item in items]
    return page(
        request,
        caller,
        "sequences/list.html",
        shown=shown,
        cursor=found.next,
        asked=asked,
        environments=ENVIRONMENTS,
        illuminations=ILLUMINATIONS,
        is_moving=any(state in ("queued", "running") for _, state, _ in shown),
    )


@router.get("/new")
def new_sequences(request: Request, caller: Curator, platform: PlatformDep) -> HTMLResponse:
    """Where bags are dropped; each becomes a sequence of its own."""
    newest = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id).order_by(CalibrationRow.id.desc())
    with platform.database.reading() as session:
        calibrations = [calibration_item(row) for row in session.scalars(newest.limit(MOST_CALIBRATIONS))]
    return page(
        request,
        caller,
        "sequences/new.html",
        needs_wasm=True,
        calibrations=calibrations,
        environments=ENVIRONMENTS,
        illuminations=ILLUMINATIONS,
    )


def status_in_words(item: SequenceItem) -> tuple[str, str]:
    """The state that a list shows of a sequence, and in words what it means."""
    if item.job is not None and item.job.state not in TERMINAL:
        return item.job.state, "being read" if item.job.kind == "ingest.register" else "being processed"
    if item.labels is not None:
        return "ready", "labelled"
    if item.job is not None and item.job.state == "failed":
        return "failed", "failed"
    return ("received", "not labelled yet") if item.recordings else ("empty", "no recording yet")
