"""Routes for administrators: ground truths of phases, and results reported by others.

**Conventions.** A ground truth is shown by its number, state and hashes; its content has no route.
"""

from fastapi import APIRouter, Request, Response
from sqlalchemy import select
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep
from api.etags import require_match, set_head
from api.paging import Page, PageDep, page, whole
from api.schemas.base import IdPath
from api.schemas.truths import NewTruthBody, ReportedBody, ReportedItem, TruthAccepted, TruthItem
from api.views.jobs import job_items
from api.views.truths import reported_item, reported_tag, truth_items
from api.visible import dataset_of, phase_of
from services.domain.benchmarks.phases.ground_truths import compare_frames, start_truth
from services.domain.benchmarks.phases.phases import lock_phase
from services.domain.benchmarks.phases.reported_results import put_reported, reported_in
from services.runtime.orm import Dataset, GroundTruthRow, Phase

router = APIRouter(prefix="/admin/phases/{phase_id}", tags=["benchmarks"])


@router.post("/ground-truths", status_code=202, responses=refusals(404, 409))
def create_ground_truth(
    phase_id: IdPath, body: NewTruthBody, caller: Administrator, platform: PlatformDep, response: Response
) -> TruthAccepted:
    """Create a ground truth. If the phase has entries, its version must have exactly the same frames."""
    with platform.database.reading() as session:
        phase = phase_of(session, phase_id)
        dataset = _dataset(session, phase, body.dataset)
    compared = compare_frames(platform, phase.id, dataset)
    with platform.database.transaction() as session:
        truth, job = start_truth(session, phase, dataset, caller.user_id, compared)
        facts = {"phase_id": phase.id, "number": truth.number, "dataset": dataset.name, "job_id": job.id}
        audit.record_admin_act(session, caller, "ground_truth.create", truth.id, body.reason, facts)
        shown = TruthAccepted(ground_truth=truth_items(session, phase, [truth])[0], job=job_items(session, [job])[0])
    return set_head(response, shown, location=f"/api/v1/jobs/{job.id}")


@router.get("/ground-truths", responses=refusals(404))
def list_ground_truths(
    phase_id: IdPath, _caller: Administrator, platform: PlatformDep, query: PageDep
) -> Page[TruthItem]:
    """List the ground truths of the phase, newest first."""
    with platform.database.reading() as session:
        phase = phase_of(session, phase_id)
        rows = page(
            session, select(GroundTruthRow).where(GroundTruthRow.phase_id == phase.id), GroundTruthRow.id.desc(), query
        )
        return Page[TruthItem](items=truth_items(session, phase, rows.rows), next=rows.next)


@router.get("/reported", summary="List the reported rows of the phase", responses=refusals(404))
def list_reported_results(
    phase_id: IdPath, _caller: Administrator, platform: PlatformDep, response: Response
) -> Page[ReportedItem]:
    """Return the rows by method and modality. You can send the list back unchanged."""
    with platform.database.reading() as session:
        items = [reported_item(row) for row in reported_in(session, phase_of(session, phase_id).id)]
    return set_head(response, whole(items), tag=reported_tag(items))


@router.put("/reported", summary="Replace all reported rows of the phase", responses=refusals(404, 409, 412))
def replace_reported_results(
    phase_id: IdPath, body: ReportedBody, caller: Administrator, platform: PlatformDep, request: Request
) -> Page[ReportedItem]:
    """Replace the rows, which the board marks and never ranks.

    With If-Match, the request fails if the rows have changed since.
    """
    with platform.database.transaction() as session:
        phase = lock_phase(session, phase_of(session, phase_id).id)
        if "if-match" in request.headers:
            require_match(request, reported_tag([reported_item(row) for row in reported_in(session, phase.id)]))
        rows = put_reported(session, phase, [item.row() for item in body.rows])
        audit.record_admin_act(session, caller, "reported.put", phase.id, body.reason, {"rows": len(rows)})
        return whole([reported_item(row) for row in rows])


def _dataset(session: Session, phase: Phase, name: str | None) -> Dataset:
    return dataset_of(session, name) if name is not None else session.get_one(Dataset, phase.dataset_id)
