"""Routes that process a sequence and serve its products: report, frames, mesh, previews.

**Conventions.** Products belong to the newest labels of the sequence. Equal requests are one run: a repetition returns
the run that is in progress or has made the labels.
"""

from fastapi import APIRouter, Request, Response
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Caller, Curator, Looker, PlatformDep
from api.errors import NotFoundError
from api.etags import set_head
from api.files import GeneratedFile, answer_file, answer_made, file_responses
from api.paging import Page, PageDep, page
from api.schemas.base import IdPath
from api.schemas.jobs import JobDetail
from api.schemas.sequences.sequences import FrameItem, ProcessBody
from api.views.ground_offer import require_ground
from api.views.jobs import job_detail
from api.views.preview_files import PICTURE_TYPES, PictureName, picture_in, sequence_preview
from api.views.scenes import ColoursQuery, artefact_file
from api.visible import labels_of, newest_label_set, sequence_of, shown_sequence
from services.domain.sequences.processing import start_processing
from services.runtime.orm import LabelledFrameRow
from services.runtime.platform import Platform

router = APIRouter(prefix="/sequences/{sequence_id}", tags=["processing"])


@router.post("/process", status_code=202, responses=refusals(403, 404, 409))
def process_sequence(
    sequence_id: IdPath, body: ProcessBody, caller: Curator, platform: PlatformDep, response: Response
) -> JobDetail:
    """Label a sequence; the job at `Location` reports its progress.

    If the recording shows the ground far off the ego origin of the calibration, the request is refused unless `ground`
    is `auto`.
    """
    run_request = body.chosen()
    with platform.database.reading() as session:
        sequence_of(session, caller, sequence_id)
    require_ground(platform, sequence_id, run_request)
    with platform.database.transaction() as session:
        sequence = sequence_of(session, caller, sequence_id)
        job = start_processing(session, sequence, run_request)
        audit.record(session, caller, "sequence.process", sequence.id, facts={"job_id": job.id})
        return set_head(response, job_detail(session, job), location=f"/api/v1/jobs/{job.id}")


@router.get("/frames", responses=refusals(404))
def list_frames(sequence_id: IdPath, caller: Looker, platform: PlatformDep, query: PageDep) -> Page[FrameItem]:
    """List the labelled frames in the order of time."""
    with platform.database.reading() as session:
        labels = newest_label_set(session, shown_sequence(session, caller, sequence_id).id)
        statement = select(LabelledFrameRow).where(LabelledFrameRow.label_set_id == labels.id)
        return page(session, statement, LabelledFrameRow.ordinal, query).shown(FrameItem.of)


@router.get(
    "/report",
    summary="Download the labelling report",
    response_class=Response,
    responses=file_responses("application/json"),
)
def download_report(sequence_id: IdPath, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """Return the sources and parameters of the labels, the quality of the poses, and the findings."""
    return _artefact(request, platform, caller, sequence_id, "report.json")


@router.get("/frames.parquet", response_class=Response, responses=file_responses("application/vnd.apache.parquet"))
def download_frame_table(sequence_id: IdPath, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """Download one row for each LiDAR stamp (Parquet): token, pose, associated data, and the reason if the frame is
    excluded.
    """
    return _artefact(request, platform, caller, sequence_id, "frames.parquet")


@router.get("/grid.json", response_class=Response, responses=file_responses("application/json"))
def download_grid(sequence_id: IdPath, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """Download the grid of the labels, as `stone score --grid` reads it; labels of older releases have no such file."""
    return _artefact(request, platform, caller, sequence_id, "grid.json")


@router.get(
    "/sequence.npz",
    summary="Download the synchronised sequence (npz)",
    response_class=Response,
    responses=file_responses("application/octet-stream"),
)
def download_synchronised_sequence(
    sequence_id: IdPath, caller: Looker, platform: PlatformDep, request: Request
) -> Response:
    """Return the sequence; with its recording, `stone export` converts it to other formats."""
    return _artefact(request, platform, caller, sequence_id, "sequence.npz")


@router.get("/mesh", response_class=Response, responses=file_responses("model/ply"))
def download_mesh(sequence_id: IdPath, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """Download the mesh of the whole sequence as binary PLY; supports ranges."""
    return _artefact(request, platform, caller, sequence_id, "mesh.ply")


@router.get(
    "/previews/{name}",
    summary="Download a preview picture of a sequence",
    response_class=Response,
    responses=file_responses(*PICTURE_TYPES),
)
def download_preview(
    sequence_id: IdPath,
    name: PictureName,
    caller: Looker,
    platform: PlatformDep,
    request: Request,
    colours: ColoursQuery = "default",
) -> Response:
    """Return a preview: `bev.png` shows the labels from above, `overlay_CAM_FRONT.jpg` LiDAR points on a camera image.

    Overlays belong to the run that made the active labels, or to the last run if there are no labels.
    """
    with platform.database.reading() as session:
        sequence = shown_sequence(session, caller, sequence_id)
        labels = labels_of(session, sequence.id)
        file = artefact_file(session, sequence, labels, name) or sequence_preview(session, sequence, labels, name)
    if colours == "default":
        return answer_file(request, platform.store, file)
    facts = GeneratedFile(file.media_type, file.filename, file.is_lasting)
    return answer_made(request, picture_in(platform.store, file, colours), facts)


def _artefact(request: Request, platform: Platform, caller: Caller, sequence_id: str, name: str) -> Response:
    """Return a file of the newest labels, named after the sequence. Raises `NotFoundError`."""
    with platform.database.reading() as session:
        sequence = shown_sequence(session, caller, sequence_id)
        file = artefact_file(session, sequence, newest_label_set(session, sequence.id), name)
    if file is None:
        raise NotFoundError("file of this sequence", name)
    return answer_file(request, platform.store, file)
