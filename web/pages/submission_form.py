"""The form by which a team submits predictions: checked in the page, then checked or scored by the platform."""

from collections.abc import Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import select
from sqlalchemy.orm import Session

from api.client_wheel import ClientWheel
from api.deps import Caller, Looker, PlatformDep
from api.routes.benchmarks import PhasePath
from api.schemas.submissions import SubmissionDetail
from api.views.benchmarks import phase_item, phases_of
from api.views.submissions import quota_answer, submission_detail
from api.visible import submissions_of
from services.domain.benchmarks.starter import manifest_filename
from services.domain.benchmarks.submissions.submissions import largest_bytes
from services.runtime.orm import Benchmark, Phase, PhaseTeam, SubmissionRow, Team, TeamMember, Upload
from services.runtime.platform import Platform
from services.runtime.uploads.completion import bytes_here
from web.boards.submission_steps import StepsPlace, predict_line, submission_steps
from web.rendering import page

router = APIRouter()
MOST_DRAFTS = 10
AtPhase = Annotated[PhasePath, Depends(PhasePath)]


@router.get("/benchmarks/{benchmark_name}/{phase_name}/submit")
def show_form(request: Request, caller: Looker, platform: PlatformDep, at: AtPhase) -> HTMLResponse:
    """Show only the steps to a visitor; signed-in users need the scope to submit, as for the routes."""
    with platform.database.reading() as session:
        row = at.find(session)
        owner = session.get_one(Benchmark, row.benchmark_id)
        phase, teams = phase_item(session, row), [] if caller.is_visitor else own_teams(session, row, caller)
        of_caller = [] if caller.is_visitor else _drafts(session, row, caller)
        drafts = [(draft, _upload(session, draft, caller)) for draft in of_caller]
        values: dict[str, Any] = {
            "owner": owner,
            "phases": phases_of(session, owner),
            "benchmark": owner.title or at.benchmark,
            "standings": [(team, quota_answer(session, row, team.id)) for team in teams],
        }
    values |= {
        "drafts": [(draft, bytes_here(platform, upload) if upload else 0) for draft, upload in drafts],
        "most_bytes": largest_bytes(phase.active.frames) if phase.active else 0,
        "at": at,
        "grid": phase.grid,
        "manifest": manifest_filename(at.benchmark, at.phase),
        "predict_line": predict_line(at.benchmark, at.phase),
        "steps": submission_steps(_steps_of(request, platform, at, teams)),
    }
    return page(request, caller, "submissions/form.html", needs_wasm=True, phase=phase, **values)


def _steps_of(request: Request, platform: Platform, at: PhasePath, teams: Sequence[Team]) -> StepsPlace:
    wheel: ClientWheel | None = request.app.state.client_wheel
    url = platform.settings.api.url.rstrip("/")
    return StepsPlace(url, wheel, at.benchmark, at.phase, teams[0].name if teams else None)


def own_teams(session: Session, phase: Phase, caller: Caller) -> list[Team]:
    """Return the teams that the caller may submit for: their team in this phase, else all their teams."""
    mine = select(Team).join(TeamMember, TeamMember.team_id == Team.id).where(TeamMember.user_id == caller.user_id)
    bound = session.get(PhaseTeam, (phase.id, caller.user_id))
    if bound is not None:
        mine = mine.where(Team.id == bound.team_id)
    return list(session.scalars(mine.order_by(Team.name)))


def _drafts(session: Session, phase: Phase, caller: Caller) -> list[SubmissionDetail]:
    """Return the caller's unfinished drafts, newest first."""
    mine = submissions_of(caller).where(SubmissionRow.user_id == caller.user_id, SubmissionRow.phase_id == phase.id)
    newest = mine.where(SubmissionRow.state == "draft").order_by(SubmissionRow.id.desc()).limit(MOST_DRAFTS)
    return [submission_detail(session, row) for row in session.scalars(newest)]


def _upload(session: Session, draft: SubmissionDetail, caller: Caller) -> Upload | None:
    """Return the caller's own unfinished upload for the draft, if there is one."""
    own = select(Upload).where(Upload.id == draft.upload_id, Upload.owner_id == caller.user_id)
    return session.scalars(own).one_or_none()
