"""Routes of uploads by tus 1.0, and their state as JSON.

**Conventions.** tus responses have no body, refusals are problems. Other users' uploads do not exist (404). A
submission requires the scope `submit`, other uploads the scope `upload`; either can resume a submission. A route that
receives bytes is asynchronous and leaves disk and database to threads (`api/tus/body_stream.py`).
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Header, Request, Response
from sqlalchemy import select

from api.deps import Caller, PlatformDep, require, require_one
from api.errors import ApiError
from api.paging import Page, PageDep, page
from api.schemas.base import IdPath, LineQuery
from api.schemas.uploads import UploadItem, upload_item
from api.tus.body_stream import in_thread, receive_body
from api.tus.creation import accept_creation, accept_form, find_own
from api.tus.errors import VERSION
from api.tus.headers import (
    CREATED,
    EXTENSIONS,
    FORM,
    FORMED,
    GOT,
    HEAD_SAYS,
    OPTIONS_SAY,
    PATCHED,
    STREAM,
    TERMINATED,
    TusRoute,
    count_of,
    piece_of,
    speak_tus,
    upload_headers,
)
from services.runtime.orm import Upload
from services.runtime.telemetry.origins import link_to
from services.runtime.uploads.completion import bytes_here, settle_if_whole, terminate
from services.runtime.uploads.reception import ALGORITHMS
from services.runtime.uploads.rows import find

router = APIRouter(prefix="/uploads", tags=["uploads"], route_class=TusRoute)

Uploader = Annotated[Caller, Depends(require_one(("upload", "submit")))]
Former = Annotated[Caller, Depends(require("upload"))]
Reader = Annotated[Caller, Depends(require("read"))]
SpeakTus = Depends(speak_tus)


@router.options("", status_code=204, response_class=Response, responses=OPTIONS_SAY)
def describe_uploads(platform: PlatformDep) -> Response:
    """Describe the supported tus features; requires no token."""
    return Response(
        status_code=204,
        headers={
            "Tus-Version": VERSION,
            "Tus-Extension": EXTENSIONS,
            "Tus-Max-Size": str(platform.settings.uploads.max_bytes),
            "Tus-Checksum-Algorithm": ",".join(ALGORITHMS),
        },
    )


@router.post(
    "",
    summary="Create an upload",
    status_code=201,
    response_class=Response,
    dependencies=[SpeakTus],
    responses=CREATED,
    openapi_extra=STREAM,
)
async def create_upload(
    request: Request,
    platform: PlatformDep,
    caller: Uploader,
    _upload_length: Annotated[str, Header(alias="Upload-Length", description="Length of the file in bytes.")] = "",
    _upload_metadata: Annotated[
        str, Header(alias="Upload-Metadata", description="Pairs of key and base64 value, separated by commas.")
    ] = "",
    _upload_concat: Annotated[
        str, Header(alias="Upload-Concat", description="`partial`, or `final;` and the URLs of the parts.")
    ] = "",
) -> Response:
    """Create an upload; bytes in the body are stored at once (creation-with-upload).

    Metadata: `filename`, `purpose` (recording, calibration, submission, ground_truth or dataset, which is a tar),
    `target_id` and `sha256`. For a submission they must equal the announced values of its draft. If the platform
    already has the declared bytes of yours, `Upload-Offset` in the response is the length, and you send nothing.

    A large file can be sent in up to 15 parallel parts. Create each part with `Upload-Concat: partial`. Then create the
    whole, with its metadata, with `final;` and the URLs of the complete parts in order. Poll its offset until it is
    complete.
    """
    upload = await accept_creation(request, platform, caller)
    offset_bytes = await in_thread(bytes_here, platform, upload)
    location = f"{request.url.path.rstrip('/')}/{upload.id}"
    return Response(status_code=201, headers={"Location": location, **upload_headers(upload, offset_bytes)})


@router.post(
    "/form", summary="Upload a small file in one request", status_code=201, responses=FORMED, openapi_extra=FORM
)
async def create_upload_by_form(
    request: Request, platform: PlatformDep, caller: Former, response: Response
) -> UploadItem:
    """Store the file, for example by `curl -F file=@run.mcap -F purpose=recording -F target_id=…`."""
    upload = await accept_form(request, platform, caller)
    response.headers["Location"] = f"{request.url.path.removesuffix('/form')}/{upload.id}"
    return upload_item(upload, upload.length_bytes)


@router.head("/{upload_id}", response_class=Response, dependencies=[SpeakTus], responses=HEAD_SAYS)
def show_upload_offset(upload_id: IdPath, platform: PlatformDep, caller: Uploader) -> Response:
    """Show the offset to resume from. If an upload lacks only its last step, this request completes it."""
    upload = settle_if_whole(platform, find_own(platform, upload_id, caller))
    return Response(status_code=200, headers=upload_headers(upload, bytes_here(platform, upload)))


@router.patch(
    "/{upload_id}",
    status_code=204,
    response_class=Response,
    dependencies=[SpeakTus],
    responses=PATCHED,
    openapi_extra=STREAM,
)
async def append_to_upload(
    upload_id: IdPath,
    request: Request,
    platform: PlatformDep,
    caller: Uploader,
    _upload_offset: Annotated[str, Header(alias="Upload-Offset", description="Offset of this body in bytes.")] = "",
    _upload_checksum: Annotated[
        str | None, Header(alias="Upload-Checksum", description="`sha1` and the base64 digest of this body.")
    ] = None,
) -> Response:
    """Append the body at the offset. After a power failure, read the offset again; a complete upload is kept."""
    piece = piece_of(request, count_of(request, "Upload-Offset"))
    if "upload" not in caller.scopes:
        await in_thread(find_own, platform, upload_id, caller)
    received = await receive_body(request, platform, (upload_id, caller.user_id), piece)
    link_to(received.upload.traceparent)
    return Response(status_code=204, headers=upload_headers(received.upload, received.offset_bytes))


@router.delete("/{upload_id}", status_code=204, response_class=Response, dependencies=[SpeakTus], responses=TERMINATED)
def terminate_upload(upload_id: IdPath, platform: PlatformDep, caller: Uploader) -> Response:
    """Terminate an upload that no recording uses; its bytes and quota are released."""
    terminate(platform, find_own(platform, upload_id, caller))
    return Response(status_code=204)


@router.post(
    "/{upload_id}",
    summary="Send PATCH or DELETE to an upload by POST",
    status_code=204,
    response_class=Response,
    dependencies=[SpeakTus],
    responses=PATCHED,
    openapi_extra=STREAM,
)
async def override_upload_method(
    upload_id: IdPath,
    request: Request,
    platform: PlatformDep,
    caller: Uploader,
    x_http_method_override: Annotated[str, Header(description="Intended method: PATCH or DELETE.")] = "",
) -> Response:
    """Apply PATCH or DELETE for clients behind networks that block both methods (tus 1.0, X-HTTP-Method-Override)."""
    if x_http_method_override == "PATCH":
        return await append_to_upload(upload_id, request, platform, caller)
    if x_http_method_override == "DELETE":
        return await in_thread(terminate_upload, upload_id, platform, caller)
    raise ApiError(
        "bad_tus_header", f"X-HTTP-Method-Override is {x_http_method_override[:80]!r}; expected PATCH or DELETE"
    )


@router.get("", responses=GOT)
def list_uploads(platform: PlatformDep, caller: Reader, query: PageDep, state: LineQuery = None) -> Page[UploadItem]:
    """List your uploads, newest first."""
    mine = select(Upload).where(Upload.owner_id == caller.user_id)
    if state is not None:
        mine = mine.where(Upload.state == state)
    with platform.database.reading() as session:
        rows = page(session, mine, Upload.id.desc(), query)
    return rows.shown(lambda upload: upload_item(upload, bytes_here(platform, upload)))


@router.get("/{upload_id}", responses=GOT)
def show_upload(upload_id: IdPath, platform: PlatformDep, caller: Reader) -> UploadItem:
    """Show an upload in any state."""
    upload = find(platform.database, upload_id, caller.user_id)
    return upload_item(upload, bytes_here(platform, upload))
