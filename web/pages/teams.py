"""The pages of one's teams: the list, and one with its members, invitations and quota."""

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import func, select

from api.deps import PlatformDep, Reader
from api.paging import PageDep
from api.paging import page as paged
from api.schemas.base import IdPath
from api.schemas.teams import InvitationItem
from api.views.submissions import quota_answer
from api.views.teams import team_items
from api.visible import team_of, teams_of
from services.domain.benchmarks.teams.teams import open_invitations
from services.runtime.orm import Phase, SubmissionRow, Team
from web.rendering import page
from web.words import phase_names

router = APIRouter()


@router.get("/teams")
def list_teams(request: Request, caller: Reader, platform: PlatformDep, query: PageDep) -> HTMLResponse:
    with platform.database.reading() as session:
        rows = paged(session, teams_of(caller), Team.id.desc(), query)
        teams = team_items(session, rows.rows)
        phases = phase_names(session, [phase_id for team in teams for phase_id in team.phases])
    return page(request, caller, "teams/list.html", teams=teams, phases=phases, next=rows.next)


@router.get("/teams/{team_id}")
def show_team(team_id: IdPath, request: Request, caller: Reader, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        row = team_of(session, caller, team_id)
        team = team_items(session, [row])[0]
        phases = session.scalars(select(Phase).where(Phase.id.in_(team.phases)).order_by(Phase.id)).all()
        counted = select(func.count()).select_from(SubmissionRow).where(SubmissionRow.team_id == team_id)
        values: dict[str, Any] = {
            "invitations": [InvitationItem.of(invitation) for invitation in open_invitations(session, team_id)],
            "standings": [(phase, quota_answer(session, phase, team_id)) for phase in phases],
            "names": phase_names(session, team.phases),
            "submissions": session.scalar(counted) or 0,
        }
    leads = team.captain == caller.name
    steers = leads or caller.is_administrator
    return page(request, caller, "teams/one.html", team=team, leads=leads, steers=steers, **values)
