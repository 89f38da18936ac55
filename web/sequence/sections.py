"""Responses for the sections of a sequence's page: the head that all share, and the section's own content."""

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import Depends, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Caller, PlatformDep
from api.schemas.base import IdPath
from api.schemas.sequences.calibrations import CalibrationItem
from api.views.calibrations import calibration_item
from api.visible import theirs
from services.domain.sequences.label_sources import SOURCE_INDEX
from services.runtime.jobs.queries import title_of
from services.runtime.orm import CalibrationRow
from stone.splits.surroundings import ENVIRONMENTS, ILLUMINATIONS
from web.rendering import page
from web.sequence.runs import steps_of
from web.sequence.status import SequenceStatus

MOST_CALIBRATIONS = 200


@dataclass(frozen=True)
class Visit:
    """Which sequence is visited, on which platform."""

    request: Request
    sequence_id: IdPath
    platform: PlatformDep


AtSequence = Annotated[Visit, Depends(Visit)]


def shown_section(
    at: Visit, looking: tuple[Caller, SequenceStatus], name: str, *, needs_wasm: bool = False, **values: Any
) -> HTMLResponse:
    """The section called `name` for who looks at a sequence that stands so; `needs_wasm` where bags are uploaded."""
    caller, standing = looking
    shown = standing.sequence
    head: dict[str, Any] = {
        "standing": standing,
        "sequence": shown,
        "section": "" if name == "overview" else f"/{name}",
        "base": f"/sequences/{shown.id}",
        "api": f"/api/v1/sequences/{shown.id}",
        "is_imported": any(one.name == SOURCE_INDEX for one in shown.artefacts),
        "pictures": {one.name for one in shown.artefacts} | {one.name for one in shown.previews},
        "steps": steps_of(standing.run) if standing.run else (),
        "title_of": title_of,
        "environments": ENVIRONMENTS,
        "illuminations": ILLUMINATIONS,
    }
    return page(at.request, caller, f"sequence/{name}.html", needs_wasm=needs_wasm, **head | values)


def choosable(session: Session, caller: Caller, standing: SequenceStatus) -> list[CalibrationItem]:
    """The calibrations that whoever may change the sequence can pin, newest first; nothing for others."""
    if not standing.may_change:
        return []
    mine = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id).order_by(CalibrationRow.id.desc())
    return [calibration_item(row) for row in session.scalars(mine.limit(MOST_CALIBRATIONS))]
