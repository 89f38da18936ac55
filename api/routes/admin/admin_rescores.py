"""Routes for administrators: re-score a phase by another evaluation version, compare, activate, abandon."""

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import PlainTextResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api import audit
from api.answers import Responses, refusals
from api.deps import Administrator, PlatformDep
from api.errors import ApiError, NotFoundError
from api.etags import etag, require_match, set_head
from api.paging import Page, PageDep, page
from api.schemas.admin import ReasonBody
from api.schemas.base import IdPath
from api.schemas.rescores import ActivationItem, NewRescoreBody, RescoreDiffAnswer, RescoreItem
from api.views.rescores import rescore_item
from api.visible import phase_of
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, active, in_force
from services.domain.benchmarks.phases.phases import lock_phase
from services.domain.benchmarks.rescores.diff import rescore_diff, rescore_page
from services.domain.benchmarks.rescores.progress import rescore_progress
from services.domain.benchmarks.rescores.rescore import NewRescore, abandon, activate, start_rescore
from services.runtime.orm import Phase, Rescore

router = APIRouter(prefix="/admin/phases/{phase_id}/rescores", tags=["administration"])
NO_BOARD = "none"
MARKDOWN = "text/markdown; charset=utf-8"
Form = Annotated[Literal["json", "md"], Query(alias="format")]
AS_PAGE: Responses = {200: {"model": RescoreDiffAnswer, "content": {"text/markdown": {"schema": {"type": "string"}}}}}


@router.post("", status_code=202, responses=refusals(404, 409))
def create_rescore(
    phase_id: IdPath, body: NewRescoreBody, caller: Administrator, platform: PlatformDep, response: Response
) -> RescoreItem:
    """Score all standing entries by another ground truth or metric; a repetition scores the missing ones. The board
    stays.
    """
    with platform.database.transaction() as session:
        phase = phase_of(session, phase_id)
        new_rescore = NewRescore(_requested_pair(session, phase, body), caller.user_id, body.reason)
        rescore, _run = start_rescore(session, phase, new_rescore)
        facts = {"rescore_id": rescore.id, "truth_id": rescore.truth_id, "metric": rescore.metric}
        audit.record_admin_act(session, caller, "phase.rescore", phase.id, body.reason, facts)
        shown = rescore_item(session, rescore)
    return set_head(response, shown, location=f"/api/v1/admin/phases/{phase_id}/rescores/{shown.id}")


@router.get("", responses=refusals(404))
def list_rescores(phase_id: IdPath, _caller: Administrator, platform: PlatformDep, query: PageDep) -> Page[RescoreItem]:
    """List the re-scores of the phase, newest first."""
    with platform.database.reading() as session:
        of_phase = select(Rescore).where(Rescore.phase_id == phase_of(session, phase_id).id)
        return page(session, of_phase, Rescore.id.desc(), query).shown(lambda row: rescore_item(session, row))


@router.get("/{rescore_id}", responses=refusals(404))
def show_rescore(phase_id: IdPath, rescore_id: IdPath, _caller: Administrator, platform: PlatformDep) -> RescoreItem:
    """Show a re-score and its progress."""
    with platform.database.reading() as session:
        return rescore_item(session, rescore_of(session, phase_id, rescore_id))


@router.get(
    "/{rescore_id}/diff",
    summary="Show the effects of activating a re-score",
    response_model=RescoreDiffAnswer,
    responses={**AS_PAGE, **refusals(404)},
)
def show_rescore_diff(
    phase_id: IdPath,
    rescore_id: IdPath,
    _caller: Administrator,
    platform: PlatformDep,
    response: Response,
    form: Form = "json",
) -> RescoreDiffAnswer | PlainTextResponse:
    """Return the changes of ranks and values, as JSON or as a page; the ETag is the If-Match of `activate`."""
    with platform.database.reading() as session:
        rescore = rescore_of(session, phase_id, rescore_id)
        tag = etag(board_revision(session, rescore.phase_id))
        diff = rescore_diff(session, rescore)
        if form == "md":
            text = rescore_page(diff, rescore_progress(session, rescore), rescore.reason)
            return PlainTextResponse(text, media_type=MARKDOWN, headers={"ETag": tag})
        response.headers["ETag"] = tag
        return RescoreDiffAnswer.of(diff, rescore=rescore_item(session, rescore))


@router.post("/{rescore_id}/activate", summary="Activate a re-score", responses=refusals(404, 409, 412, 428))
def activate_rescore(
    phase_id: IdPath,
    rescore_id: IdPath,
    body: ReasonBody,
    caller: Administrator,
    platform: PlatformDep,
    request: Request,
) -> ActivationItem:
    """Switch the whole board to the new pair at once; the old board stays readable by `as_of`."""
    with platform.database.transaction() as session:
        rescore = rescore_of(session, phase_id, rescore_id)
        lock_phase(session, phase_id)
        require_match(request, board_revision(session, phase_id))
        current = in_force(session, phase_id)
        row = activate(session, rescore, current.id if current else None, caller.user_id)
        facts = {"rescore_id": rescore.id, "truth_id": row.truth_id, "metric": row.metric}
        audit.record_admin_act(session, caller, "phase.activate", phase_id, body.reason, facts)
        return ActivationItem.of(row)


@router.post("/{rescore_id}/abandon", responses=refusals(404, 409))
def abandon_rescore(
    phase_id: IdPath, rescore_id: IdPath, body: ReasonBody, caller: Administrator, platform: PlatformDep
) -> RescoreItem:
    """Abandon a re-score: its run stops, and new submissions are no longer scored by its pair."""
    with platform.database.transaction() as session:
        rescore = rescore_of(session, phase_id, rescore_id)
        abandon(session, rescore, body.reason)
        audit.record_admin_act(session, caller, "phase.abandon", phase_id, body.reason, {"rescore_id": rescore.id})
        return rescore_item(session, rescore)


def _requested_pair(session: Session, phase: Phase, body: NewRescoreBody) -> EvaluationVersion:
    """Return the requested pair; missing parts equal those of the board."""
    current = active(session, phase.id)
    if current is None:
        raise ApiError("conflict", "the phase has no board yet; its first ground truth must be ready")
    return EvaluationVersion(body.truth_id or current.truth_id, body.metric or current.metric)


def rescore_of(session: Session, phase_id: str, rescore_id: str) -> Rescore:
    rescore = session.get(Rescore, rescore_id)
    if rescore is None or rescore.phase_id != phase_id:
        raise NotFoundError("re-score", rescore_id)
    return rescore


def board_revision(session: Session, phase_id: str) -> str:
    current = in_force(session, phase_id)
    return current.id if current else NO_BOARD
