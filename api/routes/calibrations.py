"""Calibrations: a file comes in, is read at once, and is refused or kept for ever."""

from typing import Annotated

from fastapi import APIRouter, Depends, File, Query, Request, Response, UploadFile
from sqlalchemy import select

from api import audit, calibration_reading
from api.answers import refusals
from api.callers import Curator, Reader
from api.deps import PlatformDep
from api.etags import etag
from api.files import StoredFile, answer_file, file_responses
from api.paging import Page, PageDep, page
from api.schemas.base import PLAIN, IdPath, instant
from api.schemas.calibrations import CalibrationItem, FindingItem, SensorItem
from api.tus_errors import UnsupportedMediaTypeError
from api.visible import calibration_of, theirs
from services.runtime import blobs
from services.runtime.calibrations import add_calibration
from services.runtime.orm import Blob, Calibration

router = APIRouter(prefix="/calibrations", tags=["calibrations"])
YAML = "application/yaml"
CalibrationUpload = Annotated[UploadFile, File(description="a native calibration file (YAML), at most 1 MiB")]
FORM = "multipart/form-data"
NameQuery = Annotated[str | None, Query(pattern=PLAIN, max_length=100)]


def refuse_other_types(request: Request) -> None:
    """Raises `UnsupportedMediaTypeError` for a body that is no form."""
    given = request.headers.get("content-type", "")
    if given.partition(";")[0].strip().lower() != FORM:
        raise UnsupportedMediaTypeError(given, FORM)


FormOnly = Annotated[None, Depends(refuse_other_types)]


@router.post("", status_code=201, responses={200: {"model": CalibrationItem}, **refusals(413, 415)})
def add_calibration_file(
    caller: Curator, _form: FormOnly, file: CalibrationUpload, platform: PlatformDep, response: Response
) -> CalibrationItem:
    """Keep a calibration: 201 for a new version of its name, 200 for bytes that are known already."""
    with calibration_reading.received(file.file, file.filename or "") as path:
        read = calibration_reading.read(path)
        prepared = blobs.prepare(platform.store, platform.database, path)
        with platform.database.transaction() as session:
            row, is_new = add_calibration(session, caller.user_id, read, prepared)
            if is_new:
                audit.record(session, caller, "calibration.add", row.id, facts={"sha256": row.sha256})
            shown = _item(row)
    response.status_code = 201 if is_new else 200
    response.headers["Location"] = f"/api/v1/calibrations/{shown.id}"
    response.headers["ETag"] = etag(shown.sha256)
    return shown


@router.get("", responses=refusals(403))
def list_calibrations(
    caller: Reader, platform: PlatformDep, query: PageDep, name: NameQuery = None
) -> Page[CalibrationItem]:
    """The caller's calibrations, newest first; an administrator sees everybody's."""
    statement = theirs(select(Calibration), caller, Calibration.owner_id)
    statement = statement if name is None else statement.where(Calibration.name == name)
    with platform.database.reading() as session:
        return page(session, statement, Calibration.id.desc(), query).shown(_item)


@router.get("/{calibration_id}", responses=refusals(404))
def show_calibration(
    calibration_id: IdPath, caller: Reader, platform: PlatformDep, response: Response
) -> CalibrationItem:
    """A calibration's sensors and what was noticed about it."""
    with platform.database.reading() as session:
        shown = _item(calibration_of(session, caller, calibration_id))
    response.headers["ETag"] = etag(shown.sha256)
    return shown


@router.get("/{calibration_id}/file", response_class=Response, responses=file_responses(YAML))
def download_calibration(calibration_id: IdPath, caller: Reader, platform: PlatformDep, request: Request) -> Response:
    """The file as it was uploaded."""
    with platform.database.reading() as session:
        row = calibration_of(session, caller, calibration_id)
        blob = session.get_one(Blob, row.blob_sha256)
        file = StoredFile(blob.object_key, blob.size_bytes, blob.sha256, YAML, row.filename)
    return answer_file(request, platform.store, file)


def _item(row: Calibration) -> CalibrationItem:
    return CalibrationItem(
        id=row.id,
        owner_id=row.owner_id,
        name=row.name,
        version=row.version,
        filename=row.filename,
        sha256=row.sha256,
        sensors=[SensorItem(**sensor) for sensor in row.sensors],
        findings=[FindingItem(**finding) for finding in row.findings],
        created_at=instant(row.created_ns),
    )
