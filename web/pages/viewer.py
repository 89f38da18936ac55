"""The 3D viewer of a sequence, a page around `modules/viewer/mount.js`: `/sequences/{id}/view?frame=…&compare=…`.

**Conventions.** The page checks access and shows a message if there are no labels; the API's routes of the scene
provide the data. `frame` is the first frame of the timeline; the module keeps it in the URL. `compare` names a
comparison of two label sets to show first. Without it the newest comparison with the active label set is offered as a
colour, to viewers with access to comparisons. The module keeps more values in the URL (layers, colour, camera), which
the server ignores.
"""

from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import func, or_, select
from sqlalchemy.orm import Session

from api.deps import Looker, PlatformDep
from api.schemas.base import ID_PATTERN, IdPath
from api.views.sequences import sequence_items
from api.visible import labels_of, sequences_of, shown_sequence
from services.runtime.orm import LabelComparison, LabelSet, SequenceRow
from web.assets import Assets
from web.rendering import page
from web.sequence.recording import RIG
from web.sequence.status import may_change_own

router = APIRouter()
PRELOADED = ("modules/viewer/", "modules/libraries/three")
LATER = ("modules/viewer/controls/pictures.js", "modules/viewer/drawing/sensors.js")
"""Modules that the viewer imports only if they are wanted."""


@router.get("/sequences/{sequence_id}/view")
def view(
    sequence_id: IdPath,
    request: Request,
    caller: Looker,
    platform: PlatformDep,
    frame: Annotated[str | None, Query(pattern=ID_PATTERN)] = None,
    compare: Annotated[str | None, Query(pattern=ID_PATTERN)] = None,
) -> HTMLResponse:
    with platform.database.reading() as session:
        sequence = sequence_items(session, [shown_sequence(session, caller, sequence_id)])[0]
        is_own = session.scalar(sequences_of(caller).where(SequenceRow.id == sequence_id)) is not None
        label_sets = _label_sets(session, sequence_id) if is_own else 0
        difference = _newest_comparison(session, sequence_id) if label_sets > 1 else None
    values: dict[str, Any] = {
        "sequence": sequence,
        "start": frame or "first",
        "comparison": compare,
        "difference": difference,
        "label_sets": label_sets,
        "may_change": is_own and may_change_own(caller),
        "rig": RIG,
        "modules": _modules(request),
    }
    return page(request, caller, "viewer/view.html", **values)


def _label_sets(session: Session, sequence_id: str) -> int:
    return session.scalar(select(func.count()).select_from(LabelSet).where(LabelSet.sequence_id == sequence_id)) or 0


def _newest_comparison(session: Session, sequence_id: str) -> str | None:
    """Return the newest comparison with the active label set; frames are compared on demand."""
    labels = labels_of(session, sequence_id)
    if labels is None:
        return None
    is_of_labels = or_(LabelComparison.a_id == labels.id, LabelComparison.b_id == labels.id)
    newest = select(LabelComparison.id).where(is_of_labels).order_by(LabelComparison.id.desc())
    return session.scalar(newest.limit(1))


def _modules(request: Request) -> list[str]:
    """Return URLs of the viewer's first modules, so that a browser can load them in parallel."""
    assets: Assets = request.app.state.pages.assets
    return [assets.url(path) for path in assets.files if path.startswith(PRELOADED) and path not in LATER]
