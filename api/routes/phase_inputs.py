"""Routes of phase inputs: create (administrators), list and download (signed-in users).

**Conventions.** An input is the nuScenes layout of one sequence without data made from labels, and never changes. Its
tar is generated on the fly and supports ranges, so that a download can resume.
"""

from typing import Annotated

from fastapi import APIRouter, Path, Request, Response

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep, Reader
from api.errors import NotFoundError
from api.etags import set_head
from api.files import answer_bytes, file_responses
from api.paging import Page, PageDep, page
from api.schemas.admin import ReasonBody
from api.schemas.base import IdPath
from api.schemas.jobs import JobDetail
from api.schemas.phase_bodies import PhaseInputItem
from api.views.exports import served_archive
from api.views.jobs import job_detail
from api.visible import phase_of
from services.domain.benchmarks.phases.inputs import inputs_of, locate_input, start_inputs
from services.runtime.orm import PhaseInput
from services.runtime.store.pack_reading import stored_files
from stone.sensors.sequence import NAME
from stone_files.archives import MEDIA_TYPES

router = APIRouter(tags=["phase inputs"])
SequenceName = Annotated[str, Path(pattern=f"^{NAME.pattern}$", examples=["n-forest-07"])]
TAR = file_responses(MEDIA_TYPES["tar"])


@router.post(
    "/admin/phases/{phase_id}/inputs",
    summary="Create a phase's missing inputs",
    status_code=202,
    responses=refusals(404, 409),
)
def create_phase_inputs(
    phase_id: IdPath, body: ReasonBody, caller: Administrator, platform: PlatformDep, response: Response
) -> JobDetail:
    """Create the inputs of every sequence of the phase without inputs; the job at `Location` reports the progress."""
    with platform.database.transaction() as session:
        run = start_inputs(session, phase_of(session, phase_id), caller.user_id)
        audit.record_admin_act(session, caller, "phase.inputs", phase_id, body.reason, {"job_id": run.id})
        return set_head(response, job_detail(session, run), location=f"/api/v1/jobs/{run.id}")


@router.get("/phases/{phase_id}/inputs", summary="List the available inputs of the phase", responses=refusals(404))
def list_phase_inputs(phase_id: IdPath, _caller: Reader, platform: PlatformDep, query: PageDep) -> Page[PhaseInputItem]:
    with platform.database.reading() as session:
        phase = phase_of(session, phase_id)
        return page(session, inputs_of(phase.id), PhaseInput.name, query).shown(PhaseInputItem.of)


@router.get(
    "/phases/{phase_id}/inputs/{sequence_name}.tar",
    summary="Download a sequence's inputs of the phase (tar)",
    response_class=Response,
    responses=TAR,
)
@router.head(
    "/phases/{phase_id}/inputs/{sequence_name}.tar",
    summary="Show size and checksum of a sequence's inputs (phase)",
    response_class=Response,
    responses=TAR,
    name="describe_phase_input",
    description="Show size and checksum of a sequence's inputs (phase).",
)
def download_phase_input(
    phase_id: IdPath, sequence_name: SequenceName, _caller: Reader, platform: PlatformDep, request: Request
) -> Response:
    """Return the tar; supports ranges. `sha256sum.txt` in it contains the checksums of all other files."""
    with platform.database.reading() as session:
        row = session.get(PhaseInput, (phase_of(session, phase_id).id, sequence_name))
        if row is None:
            raise NotFoundError("input of this phase", sequence_name)
        located = locate_input(session, row)
    stored = stored_files(platform.store, located)
    return answer_bytes(request, served_archive(platform.store, stored, "tar", (row.name, row.tar_sha256)))
