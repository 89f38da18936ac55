"""The pages of the dataset: its composition, its versions with their downloads, and publishing a new one.

**Conventions.** Without a version in the query the newest is shown; `version=` (empty) shows the labelled sequences of
one's own, as the splits stand. Of test's labels no page tells anything.
"""

from typing import Annotated, Any

from fastapi import Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Administrator, PlatformDep, Reader
from api.noun_router import NounRouter
from api.paging import PageQuery
from api.paging import page as rows_of
from api.schemas.datasets import VERSION_PATTERN, DatasetItem
from api.views.datasets import dataset_detail, dataset_item, prospect_of
from api.views.statistics import composition_record
from api.visible import dataset_of
from services.domain.datasets.statistics import Record
from services.runtime.orm import Dataset
from stone.splits.splits import PARTS
from web.pages.dataset_figure import figure_of
from web.rendering import page

router = NounRouter()
SHOWN = 50
OF_ONES_OWN = ""
Version = Annotated[str | None, Query(pattern=f"{VERSION_PATTERN}|^$")]


@router.get("/dataset")
def dataset(
    request: Request, caller: Reader, platform: PlatformDep, version: Version = None, cursor: str | None = None
) -> HTMLResponse:
    with platform.database.reading() as session:
        versions, following = _versions(session, cursor)
        newest = session.scalar(select(Dataset.name).order_by(Dataset.id.desc()).limit(1))
        chosen = (newest or OF_ONES_OWN) if version is None else version
        record = composition_record(session, caller, chosen or None)
        detail = dataset_detail(session, dataset_of(session, chosen)) if chosen else None
    return page(
        request,
        caller,
        "dataset/dataset.html",
        chosen=chosen,
        versions=versions,
        following=following,
        record=record,
        figure=figure_of(record),
        parts=_parts(record),
        detail=detail,
        base=platform.settings.api.url.rstrip("/"),
        has_own=caller.role in ("curator", "administrator"),
    )


@router.get("/dataset/new")
def new_version(request: Request, caller: Administrator, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        prospect = prospect_of(session)
        versions, _ = _versions(session, None)
    record = prospect.statistics
    return page(
        request,
        caller,
        "dataset/new.html",
        prospect=prospect,
        parts=_parts(record) if record else [],
        licence=versions[0].licence if versions else "",
        newest=versions[0].name if versions else "",
    )


def _versions(session: Session, cursor: str | None) -> tuple[list[DatasetItem], str | None]:
    found = rows_of(session, select(Dataset), Dataset.id.desc(), PageQuery(cursor, SHOWN))
    return [dataset_item(session, row) for row in found.rows], found.next


def _parts(record: Record) -> list[dict[str, Any]]:
    """Train, val, test, then what is in none, with the share of the frames and T, P and N of each."""
    rows = {row["key"]: row for row in record["parts"]}
    total = record["total"]["frames"] or 1
    return [
        {**rows[key], "share": rows[key]["frames"] / total, "counts": _counts(rows[key])}
        for key in (*PARTS, "")
        if key in rows
    ]


def _counts(row: Record) -> tuple[int, ...]:
    return tuple(row["voxels"].values()) if row["voxels"] else (0, 0, 0)
