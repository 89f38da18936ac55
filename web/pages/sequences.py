"""The list of sequences, with picture, status and content each, and the page that creates new ones.

**Conventions.** An empty filter field is ignored. The list contains the sequences of the API's list.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from api.deps import Caller, Curator, Looker, PlatformDep
from api.lists.answers import SequenceFilters
from api.paging import PageQuery
from api.paging import page as paged
from api.schemas.base import PLAIN, LineQuery
from api.schemas.sequences.calibrations import CalibrationItem
from api.schemas.sequences.sequences import SequenceItem
from api.views.sequences import sequence_items
from api.visible import sequences_shown_to, theirs
from services.runtime.orm import CalibrationRow, SequenceRow, Upload
from services.runtime.uploads.completion import bytes_here
from stone.splits.surroundings import ILLUMINATIONS, OFFERED
from web.rendering import page
from web.sequence.sequence_states import SequenceRuns, is_troubled, runs_of, state_of

router = APIRouter(prefix="/sequences")
SHOWN = 24
MOVING = ("queued", "processing", "reading")
MOST_CALIBRATIONS = 200
MOST_REMEMBERED = 1000
Cursor = Annotated[str | None, Query(max_length=512)]
Contains = Annotated[str | None, Query(pattern=PLAIN, max_length=100, description="part of the name")]
Whose = Annotated[Literal["", "mine"], Query(description="all visible sequences, or your own")]


@dataclass(frozen=True)
class SequenceFilterForm:
    """The fields of the form above the list."""

    name: Contains = None
    environment: LineQuery = None
    illumination: LineQuery = None
    whose: Whose = ""

    @property
    def is_narrow(self) -> bool:
        return any((self.name, self.environment, self.illumination, self.whose))

    def narrowed(self, statement: Select[SequenceRow], caller: Caller) -> Select[SequenceRow]:
        """Filter by a part of the name in any case; the API's `name` is an exact prefix."""
        filters = SequenceFilters(
            environment=self.environment or None,
            illumination=self.illumination or None,
            owner_id=caller.user_id if self.whose and caller.user_id else None,
        )
        filtered = filters.narrowed(statement)
        return filtered.where(SequenceRow.name.icontains(self.name, autoescape=True)) if self.name else filtered


@router.get("")
def list_sequences(
    request: Request,
    caller: Looker,
    platform: PlatformDep,
    asked: Annotated[SequenceFilterForm, Depends()],
    cursor: Cursor = None,
) -> HTMLResponse:
    """List the sequences, newest first; the page updates running work automatically."""
    narrowed = asked.narrowed(sequences_shown_to(caller), caller)
    with platform.database.reading() as session:
        rows = paged(session, narrowed, SequenceRow.id.desc(), PageQuery(cursor or None, SHOWN))
        items = sequence_items(session, rows.rows, caller)
        own = [item.id for item in items if caller.is_administrator or item.owner_id == caller.user_id]
        runs = runs_of(session, own)
        begun = uploads_begun(session, [item.id for item in items if item.id in own and not item.recordings])
    sent = {upload.target_id: (bytes_here(platform, upload), upload.length_bytes) for upload in begun}
    known = [(item, runs.get(item.id, SequenceRuns())) for item in items]
    shown = [(item, state_of(item, of_item), is_rerun_failed(item, of_item)) for item, of_item in known]
    return page(
        request,
        caller,
        "sequences/list.html",
        shown=shown,
        sent=sent,
        cursor=rows.next,
        asked=asked,
        environments=OFFERED,
        illuminations=ILLUMINATIONS,
        is_moving=any(state in MOVING for _, state, _ in shown),
    )


@router.get("/new")
def new_sequences(request: Request, caller: Curator, platform: PlatformDep) -> HTMLResponse:
    """Show the page for dropping bags; each bag becomes a sequence."""
    newest = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id).order_by(CalibrationRow.id.desc())
    with platform.database.reading() as session:
        calibrations = [CalibrationItem.of(row) for row in session.scalars(newest.limit(MOST_CALIBRATIONS))]
        last_used = calibrations_by_robot(session, caller.user_id)
    ids = {calibration.id for calibration in calibrations}
    return page(
        request,
        caller,
        "sequences/new.html",
        needs_wasm=True,
        calibrations=calibrations,
        of_robots={robot: known for robot, known in last_used.items() if known in ids},
        environments=OFFERED,
        illuminations=ILLUMINATIONS,
    )


def uploads_begun(session: Session, sequence_ids: Sequence[str]) -> Sequence[Upload]:
    """Return the unfinished uploads of recordings to these sequences, oldest first."""
    begun = select(Upload).where(Upload.target_id.in_(sequence_ids), Upload.purpose == "recording")
    return session.scalars(begun.where(Upload.state == "open").order_by(Upload.id)).all()


def is_rerun_failed(item: SequenceItem, runs: SequenceRuns) -> bool:
    """Return whether the sequence has labels, and its last labelling, which was to replace them, did not succeed."""
    return item.labels is not None and is_troubled(item, runs)


def calibrations_by_robot(session: Session, owner_id: str) -> dict[str, str]:
    """Return the id of the owner's last calibration for each robot; newest robot first."""
    columns = select(SequenceRow.platform, SequenceRow.calibration_id)
    own = columns.where(SequenceRow.owner_id == owner_id, SequenceRow.deleted_ns.is_(None))
    used = own.where(SequenceRow.platform != "", SequenceRow.calibration_id.is_not(None))
    by_robot: dict[str, str] = {}
    for robot, calibration_id in session.execute(used.order_by(SequenceRow.id.desc()).limit(MOST_REMEMBERED)):
        by_robot.setdefault(robot, calibration_id or "")
    return by_robot
