"""Routes of dataset statistics, as JSON and as a figure.

**Conventions.** Both come from the same record, so they cannot differ. They never include the labels of test.
"""

from hashlib import sha256
from json import dumps
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from api.answers import refusals
from api.deps import Caller, PlatformDep, Reader
from api.etags import etag, is_unchanged
from api.schemas.datasets import VERSION_PATTERN
from api.schemas.statistics import StatisticsAnswer
from api.views.scenes import ColoursQuery
from api.views.statistics import composition_record
from services.domain.datasets.composition_figure import FIGURE_VERSION, composition_png, figure_title
from services.domain.datasets.statistics import Record
from services.runtime.platform import Platform

router = APIRouter(prefix="/statistics", tags=["dataset"])
VersionQuery = Annotated[str | None, Query(pattern=VERSION_PATTERN, description="Name of a dataset version.")]
PNG = {"image/png": {"schema": {"type": "string", "format": "binary"}}}
NOT_MODIFIED = {"description": "The caller's copy is current"}


@router.get("", responses=refusals(404))
def show_statistics(caller: Reader, platform: PlatformDep, dataset: VersionQuery = None) -> StatisticsAnswer:
    """Show the composition by environment, illumination, region, class and split."""
    return StatisticsAnswer(dataset=dataset, **_record_of(platform, caller, dataset))


@router.get(
    "/composition.png",
    response_class=Response,
    responses={200: {"description": "The figure", "content": PNG}, 304: NOT_MODIFIED, **refusals(404)},
)
def download_composition(
    caller: Reader,
    platform: PlatformDep,
    request: Request,
    dataset: VersionQuery = None,
    colours: ColoursQuery = "default",
) -> Response:
    """Download the composition as a figure."""
    record = _record_of(platform, caller, dataset)
    title = figure_title(record["total"], dataset or "Labelled sequences")
    tag = sha256(dumps([FIGURE_VERSION, title, record, colours], sort_keys=True).encode()).hexdigest()
    headers = {"ETag": etag(tag), "Cache-Control": "private, no-cache"}
    if is_unchanged(request, tag):
        return Response(status_code=304, headers=headers)
    return Response(composition_png(record, title, colours), headers=headers, media_type="image/png")


def _record_of(platform: Platform, caller: Caller, dataset: str | None) -> Record:
    """Return the record. Raises `NotFoundError`."""
    with platform.database.reading() as session:
        return composition_record(session, caller, dataset)
