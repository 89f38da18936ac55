"""Routes of calibrations: upload, list, download, compare; a stored one never changes."""

from dataclasses import replace
from typing import Annotated

from fastapi import APIRouter, Depends, File, Form, Query, Request, Response, UploadFile
from pydantic import AwareDatetime
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Curator, PlatformDep, Reader
from api.etags import set_head
from api.files import StoredFile, answer_file, file_responses
from api.paging import Page, PageDep, page
from api.schemas.base import ID_PATTERN, PLAIN, IdPath
from api.schemas.sequences.calibrations import CalibrationDiffItem, CalibrationItem
from api.tus.errors import unsupported_media_type
from api.views import calibration_reading
from api.views.calibration_changes import changes
from api.visible import calibration_of, theirs
from services.domain.sequences.calibrations import Validity, add_calibration
from services.runtime.orm import Blob, CalibrationRow
from services.runtime.store import blobs

router = APIRouter(prefix="/calibrations", tags=["calibrations"])
YAML, ZIP = "application/yaml", "application/zip"
UPLOADED = "YAML or JSON of any known format, or a zip of files that complete each other; at most 1 MiB."
CalibrationUpload = Annotated[UploadFile, File(description=UPLOADED)]
Moment = Annotated[AwareDatetime | None, Form(description="Time from which, or up to which, the calibration holds.")]
AGAINST = "Id of the calibration to compare with (default: the previous version)."
AgainstQuery = Annotated[str | None, Query(pattern=ID_PATTERN, description=AGAINST)]
FORM = "multipart/form-data"
NameQuery = Annotated[str | None, Query(pattern=PLAIN, max_length=100)]


async def refuse_other_types(request: Request) -> None:
    """Refuse a body that is no form. Raises `unsupported_media_type`."""
    given = request.headers.get("content-type", "")
    if given.partition(";")[0].strip().lower() != FORM:
        raise unsupported_media_type(given, FORM)


async def requested_validity(valid_from: Moment = None, valid_to: Moment = None) -> Validity:
    """Return the requested validity. Raises `CalibrationRefusedError` if it is empty."""
    return calibration_reading.validity(valid_from, valid_to)


FormOnly = Annotated[None, Depends(refuse_other_types)]
ValidityDep = Annotated[Validity, Depends(requested_validity)]


@router.post(
    "",
    summary="Upload a calibration",
    status_code=201,
    responses={200: {"model": CalibrationItem}, **refusals(413, 415)},
)
def create_calibration(
    caller: Curator,
    _form: FormOnly,
    file: CalibrationUpload,
    platform: PlatformDep,
    response: Response,
    validity: ValidityDep,
) -> CalibrationItem:
    """Store the calibration: 201 for a new version of its name, 200 if the same content already exists with these
    times.
    """
    with calibration_reading.receive(file.file, file.filename or "") as path:
        read = replace(calibration_reading.read(path), validity=validity)
        prepared = blobs.prepare(platform.store, platform.database, path)
        with platform.database.transaction() as session:
            row, is_new = add_calibration(session, caller.user_id, read, prepared)
            if is_new:
                audit.record(session, caller, "calibration.add", row.id, facts={"sha256": row.sha256})
            shown = CalibrationItem.of(row)
    response.status_code = 201 if is_new else 200
    return set_head(response, shown, tag=shown.sha256, location=f"/api/v1/calibrations/{shown.id}")


@router.get("", responses=refusals(403))
def list_calibrations(
    caller: Reader, platform: PlatformDep, query: PageDep, name: NameQuery = None
) -> Page[CalibrationItem]:
    """List your calibrations, newest first; administrators see all calibrations."""
    statement = theirs(select(CalibrationRow), caller, CalibrationRow.owner_id)
    statement = statement if name is None else statement.where(CalibrationRow.name == name)
    with platform.database.reading() as session:
        return page(session, statement, CalibrationRow.id.desc(), query).shown(CalibrationItem.of)


@router.get("/{calibration_id}", responses=refusals(404))
def show_calibration(
    calibration_id: IdPath, caller: Reader, platform: PlatformDep, response: Response
) -> CalibrationItem:
    """Show a calibration's sensors and findings."""
    with platform.database.reading() as session:
        shown = CalibrationItem.of(calibration_of(session, caller, calibration_id))
    return set_head(response, shown, tag=shown.sha256)


@router.get("/{calibration_id}/file", response_class=Response, responses=file_responses(YAML, ZIP))
def download_calibration(calibration_id: IdPath, caller: Reader, platform: PlatformDep, request: Request) -> Response:
    """Download the calibration file as it was uploaded."""
    with platform.database.reading() as session:
        row = calibration_of(session, caller, calibration_id)
        blob = session.get_one(Blob, row.blob_sha256)
        media_type = ZIP if row.filename.lower().endswith(".zip") else YAML
        file = StoredFile(blob.object_key, blob.size_bytes, blob.sha256, media_type, row.filename)
    return answer_file(request, platform.store, file)


@router.get("/{calibration_id}/diff", summary="Compare two calibrations", responses=refusals(404))
def compare_calibrations(
    calibration_id: IdPath, caller: Reader, platform: PlatformDep, against: AgainstQuery = None
) -> CalibrationDiffItem:
    """Return how far each sensor moved and turned from `against` to this calibration, and the changes of its lens."""
    return changes(platform, caller, calibration_id, against)
