"""The pages of imports: a published dataset is brought in, and watched scene by scene."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select

from api.deps import Curator, PlatformDep
from api.paging import PageQuery
from api.paging import page as paged
from api.routes.dataset_imports import import_shown_to
from api.schemas.base import IdPath
from api.views.imports.items import import_detail, import_items
from api.visible import theirs
from services.domain.imports.requests import LONGEST_NAME
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import DatasetImport
from services.runtime.uploads.creation import owner_limit_bytes
from services.runtime.uploads.rows import UploadOwner
from stone.splits.surroundings import ILLUMINATIONS, OFFERED
from stone_base.label_grid import GRIDS
from stone_files.dataset_layouts import LAYOUTS
from web.rendering import page

router = APIRouter(prefix="/imports")
SHOWN = 20
Cursor = Annotated[str | None, Query(max_length=512)]


@router.get("")
def list_imports(request: Request, caller: Curator, platform: PlatformDep, cursor: Cursor = None) -> HTMLResponse:
    """Show the form, and the caller's imports, newest first."""
    mine = theirs(select(DatasetImport), caller, DatasetImport.owner_id)
    with platform.database.reading() as session:
        rows = paged(session, mine, DatasetImport.id.desc(), PageQuery(cursor, SHOWN))
        items = import_items(session, rows.rows)
    limit_bytes = min(platform.settings.uploads.max_bytes, owner_limit_bytes(platform, UploadOwner(caller.user_id)))
    return page(
        request,
        caller,
        "imports/list.html",
        needs_wasm=True,
        imports=items,
        cursor=rows.next,
        limit_bytes=limit_bytes,
        longest_name=LONGEST_NAME,
        roots=platform.settings.in_place.roots,
        layouts=LAYOUTS,
        grids=GRIDS,
        environments=OFFERED,
        illuminations=ILLUMINATIONS,
        is_moving=any(item.state not in TERMINAL for item in items),
    )


@router.get("/{import_id}")
def show_import(import_id: IdPath, request: Request, caller: Curator, platform: PlatformDep) -> HTMLResponse:
    """Show one import with its scenes; the page updates its progress automatically."""
    with platform.database.reading() as session:
        item = import_detail(session, import_shown_to(session, caller, import_id))
    return page(request, caller, "imports/one.html", item=item, is_moving=item.state not in TERMINAL)
