"""The pages of calibrations: the list with uploads, and one drawn, with its findings and changes.

**Conventions.** Users see their own calibrations, administrators all. The drawing is made from the stored file.
"""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import func, select

from api.deps import PlatformDep, Reader
from api.paging import PageQuery
from api.paging import page as paged
from api.routes.sequences.calibrations import AgainstQuery, NameQuery
from api.schemas.base import IdPath
from api.schemas.sequences.calibrations import CalibrationItem
from api.views.calibration_changes import changes, version_before
from api.visible import calibration_of, sequences_of, theirs
from services.runtime.orm import Blob, CalibrationRow, SequenceRow
from web.rendering import page
from web.rig import stored_rig

router = APIRouter(prefix="/calibrations")
SHOWN = 50
MOST_NAMED = 200
Cursor = Annotated[str | None, Query(max_length=512)]


@router.get("")
def list_calibrations(
    request: Request, caller: Reader, platform: PlatformDep, name: NameQuery = None, cursor: Cursor = None
) -> HTMLResponse:
    """List the calibrations, newest first, each with the number of sequences that use it; `name` filters by part of a
    name.
    """
    mine = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id)
    narrowed = mine.where(CalibrationRow.name.icontains(name, autoescape=True)) if name else mine
    with platform.database.reading() as session:
        rows = paged(session, narrowed, CalibrationRow.id.desc(), PageQuery(cursor or None, SHOWN))
        ids = [row.id for row in rows.rows]
        alive = SequenceRow.deleted_ns.is_(None)
        pinned = select(SequenceRow.calibration_id, func.count()).where(SequenceRow.calibration_id.in_(ids), alive)
        counts = dict(session.execute(pinned.group_by(SequenceRow.calibration_id)).all())
    shown = [(CalibrationItem.of(row), counts.get(row.id, 0)) for row in rows.rows]
    return page(request, caller, "calibrations/list.html", shown=shown, cursor=rows.next, name=name or "")


@router.get("/{calibration_id}")
def show_calibration(
    request: Request, calibration_id: IdPath, caller: Reader, platform: PlatformDep, against: AgainstQuery = None
) -> HTMLResponse:
    """Show the robot from above and the side, the findings, and the changes from the previous or another version."""
    with platform.database.reading() as session:
        row = calibration_of(session, caller, calibration_id)
        item = CalibrationItem.of(row)
        key = session.get_one(Blob, row.blob_sha256).object_key
        before = version_before(session, row)
        of_name = select(CalibrationRow).where(CalibrationRow.owner_id == row.owner_id, CalibrationRow.name == row.name)
        versions = session.scalars(of_name.order_by(CalibrationRow.version.desc()).limit(MOST_NAMED)).all()
        pins = select(SequenceRow).where(SequenceRow.id.in_(sequences_of(caller).with_only_columns(SequenceRow.id)))
        named = pins.order_by(SequenceRow.name).limit(MOST_NAMED)
        sequences = [(pin.id, pin.name, pin.calibration_id == row.id) for pin in session.scalars(named)]
    rig, unread = stored_rig(platform.store, key, item.filename)
    other = against or (before.id if before is not None else None)
    return page(
        request,
        caller,
        "calibrations/one.html",
        calibration=item,
        versions=[(version.id, version.version) for version in versions],
        sequences=sequences,
        rig=rig,
        unread=unread,
        changes=changes(platform, caller, calibration_id, other) if other and rig else None,
        against=other,
    )
