"""The 3D viewer of a sequence, a page around `modules/viewer/mount.js`: `/sequences/{id}/view?frame=…&compare=…`.

**Conventions.** The page decides who may look and what is said while there is nothing to see; what is seen comes from
the API's routes of the scene. `frame` names where the timeline begins; the module keeps it in the address. `compare`
names a comparison of two label sets whose differences can be shown.
"""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.callers import Looker
from api.deps import PlatformDep
from api.schemas.base import ID_PATTERN, IdPath
from api.views.sequences import sequence_items
from api.visible import shown_sequence
from web.assets import Assets
from web.rendering import page

router = APIRouter()
PRELOADED = ("modules/viewer/", "modules/libraries/three")


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
    start, modules = frame or "first", _modules(request)
    return page(
        request, caller, "viewer/view.html", sequence=sequence, start=start, comparison=compare, modules=modules
    )


def _modules(request: Request) -> list[str]:
    """URLs of the viewer's modules, so that a browser need not find them one file after the other."""
    assets: Assets = request.app.state.pages.assets
    return [assets.url(path) for path in assets.files if path.startswith(PRELOADED)]
