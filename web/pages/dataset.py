"""The pages of the dataset: its composition, its versions with their downloads, and publishing a new one.

**Conventions.** Without a version in the query the newest is shown; `version=` (empty) shows the viewer's own labelled
sequences with the draft splits. No page shows data from the labels of test.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import sqrt
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.deps import Administrator, PlatformDep, Reader
from api.paging import PageQuery
from api.paging import page as rows_of
from api.schemas.datasets import VERSION_PATTERN, DatasetItem
from api.views.datasets import dataset_detail, dataset_item, preview_of
from api.views.statistics import composition_record
from api.visible import dataset_of
from services.domain.datasets.statistics import CLASSES, Record
from services.runtime.orm import Dataset
from stone.splits.splits import PARTS
from stone.splits.surroundings import DAYLIGHT, ENVIRONMENTS, HALVES, ILLUMINATIONS
from stone_base.counts import counted
from web.rendering import page

router = APIRouter()
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
    least_recall = platform.settings.publishing.least_held_out_recall
    with platform.database.reading() as session:
        prospect = preview_of(session, least_recall)
        versions, _ = _versions(session, None)
    record = prospect.statistics
    return page(
        request,
        caller,
        "dataset/new.html",
        prospect=prospect,
        least_recall=least_recall,
        parts=_parts(record) if record else [],
        licence=versions[0].licence if versions else "",
        newest=versions[0].name if versions else "",
    )


def _versions(session: Session, cursor: str | None) -> tuple[list[DatasetItem], str | None]:
    versions = rows_of(session, select(Dataset), Dataset.id.desc(), PageQuery(cursor, SHOWN))
    return [dataset_item(session, row) for row in versions.rows], versions.next


def _parts(record: Record) -> list[dict[str, Any]]:
    """Return train, val, test and the unassigned rest, with the share of the frames and T, P and N of each."""
    rows = {row["key"]: row for row in record["parts"]}
    total = record["total"]["frames"] or 1
    return [
        {**rows[key], "share": rows[key]["frames"] / total, "counts": _counts(rows[key])}
        for key in (*PARTS, "")
        if key in rows
    ]


def _counts(row: Record) -> tuple[int, ...]:
    return tuple(row["voxels"].values()) if row["voxels"] else (0, 0, 0)


# The composition as a picture: environments by illuminations, squares whose areas are frames, striped by class.
# **Conventions.** This code computes geometry only, in px of an SVG at its own size; `templates/parts/composition.html`
# draws it. Every environment has a row, so that readers see missing ones.


LEFT_PX, TOP_PX, CELL_PX, ROW_PX, BAR_PX, END_PX = 128, 58, 84, 88, 150, 86
LARGEST_PX = 62


@dataclass(frozen=True)
class Stripe:
    """A class within a square: `kind` is t, p, n, or unseen where classes are not known."""

    kind: str
    y_px: float
    height_px: float


@dataclass(frozen=True)
class Square:
    """A square of the figure: an environment in one light, around its centre."""

    title: str
    x_px: float
    y_px: float
    side_px: float
    frames: int
    stripes: tuple[Stripe, ...]


@dataclass(frozen=True)
class EnvironmentLine:
    """An environment: its squares, and how far it was driven."""

    word: str
    y_px: float
    distance_m: float | None
    bar_px: float
    squares: tuple[Square, ...]


@dataclass(frozen=True)
class Heading:
    """A light, or day and night above several: where its words stand."""

    word: str
    x_px: float
    width_px: float


@dataclass(frozen=True)
class CompositionFigure:
    """The picture; `bars_px` is where distances begin."""

    width_px: int
    height_px: int
    bars_px: int
    lights: tuple[Heading, ...]
    halves: tuple[Heading, ...]
    lines: tuple[EnvironmentLine, ...]


def figure_of(record: Record) -> CompositionFigure:
    """Return the picture of a record of `statistics_record`; without sequences it has environments and no light."""
    cells = {(cell["environment"], cell["illumination"]): cell for cell in record["cells"]}
    words = _in_order({light for _, light in cells}, ILLUMINATIONS)
    places = _in_order({environment for environment, _ in cells} | {*ENVIRONMENTS}, ENVIRONMENTS)
    bars_px = LEFT_PX + CELL_PX * max(len(words), 1)
    scale = _FigureScale(cells, {row["key"]: row for row in record["environments"]})
    lines = tuple(_line(environment, number, words, scale) for number, environment in enumerate(places))
    lights = tuple(Heading(word or "unspecified", LEFT_PX + CELL_PX * n, CELL_PX) for n, word in enumerate(words))
    return CompositionFigure(
        width_px=bars_px + BAR_PX + END_PX,
        height_px=TOP_PX + ROW_PX * len(places) + 8,
        bars_px=bars_px + 24,
        lights=lights,
        halves=_halves(words),
        lines=lines,
    )


class _FigureScale:
    """Sizes of the picture's marks, relative to the largest of each."""

    def __init__(self, cells: Mapping[tuple[str, str], Record], places: Mapping[str, Record]) -> None:
        self.cells, self.places = cells, places
        self._most_frames = max((cell["frames"] for cell in cells.values()), default=0) or 1
        self._most_m = max((row["distance_m"] or 0.0 for row in places.values()), default=0.0) or 1.0

    def side_px(self, frames: int) -> float:
        return max(LARGEST_PX * sqrt(frames / self._most_frames), 4.0)

    def bar_px(self, distance_m: float | None) -> float:
        return (BAR_PX - 24) * (distance_m or 0.0) / self._most_m


def _line(place: str, number: int, words: list[str], scale: _FigureScale) -> EnvironmentLine:
    y_px = TOP_PX + ROW_PX * (number + 0.5)
    distance_m = scale.places.get(place, {}).get("distance_m")
    squares = [
        _square(cell, LEFT_PX + CELL_PX * (at + 0.5), y_px, scale.side_px(cell["frames"]))
        for at, word in enumerate(words)
        if (cell := scale.cells.get((place, word))) is not None
    ]
    return EnvironmentLine(place or "unspecified", y_px, distance_m, scale.bar_px(distance_m), tuple(squares))


def _square(cell: Record, x_px: float, y_px: float, side_px: float) -> Square:
    top_px = y_px - side_px / 2 - 6
    conditions = f"{cell['environment'] or 'unspecified'}, {cell['illumination'] or 'unspecified'}"
    title = f"{conditions}: {counted(cell['sequences'], 'sequence')}"
    return Square(title, x_px, top_px, side_px, cell["frames"], _stripes(cell["class_ratios"], top_px, side_px))


def _stripes(ratios: Mapping[str, Any] | None, top_px: float, side_px: float) -> tuple[Stripe, ...]:
    if ratios is None:
        return (Stripe("unseen", top_px, side_px),)
    stripes = list[Stripe]()
    for kind, name in zip("tpn", CLASSES, strict=True):
        height_px = side_px * ratios[name]
        stripes.append(Stripe(kind, top_px, height_px))
        top_px += height_px
    return tuple(stripes)


def _halves(words: list[str]) -> tuple[Heading, ...]:
    """Return the headings day and night over their neighbouring columns of light."""
    headings = list[Heading]()
    for half in HALVES:
        at = [index for index, word in enumerate(words) if DAYLIGHT.get(word) == half]
        if at:
            headings.append(Heading(half, LEFT_PX + CELL_PX * at[0], CELL_PX * len(at)))
    return tuple(headings)


def _in_order(words: set[str], order: tuple[str, ...]) -> list[str]:
    """Return the words in this order, then others, and unspecified last."""
    others = sorted(words - {*order, ""})
    return [*(word for word in order if word in words), *others, *([""] if "" in words else [])]
