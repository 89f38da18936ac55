"""Teams: made by anybody who may submit, seen by their members and administrators."""

from typing import Annotated

from fastapi import APIRouter, Depends
from sqlalchemy import select
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Caller, PlatformDep, require
from api.paging import Page, PageDep, page
from api.schemas.base import instant
from api.schemas.people import TeamBody, TeamItem
from services.runtime.access.errors import NameTakenError
from services.runtime.orm import Team, TeamMember, User

router = APIRouter(prefix="/teams", tags=["people"])


@router.post("", status_code=201, summary="Found a team", responses=refusals(409))
def found(body: TeamBody, caller: Annotated[Caller, Depends(require("submit"))], platform: PlatformDep) -> TeamItem:
    with platform.database.transaction() as session:
        if session.scalar(select(Team.id).where(Team.name == body.name)) is not None:
            raise NameTakenError("team", body.name)
        team = Team(name=body.name)
        session.add(team)
        session.flush()
        session.add(TeamMember(team_id=team.id, user_id=caller.user_id, is_owner=True))
        audit.record(session, caller, "team.found", team.id, facts={"name": team.name})
    return _shown(team, [caller.name])


@router.get("", summary="One's teams, newest first; for administrators all")
def listed(
    caller: Annotated[Caller, Depends(require("read"))], query: PageDep, platform: PlatformDep
) -> Page[TeamItem]:
    seen = select(Team)
    if not caller.is_administrator:
        own = select(TeamMember.team_id).where(TeamMember.user_id == caller.user_id)
        seen = seen.where(Team.id.in_(own))
    with platform.database.reading() as session:
        rows = page(session, seen, Team.id.desc(), query)
        names = _members(session, [team.id for team in rows.rows])
    return rows.shown(lambda team: _shown(team, names.get(team.id, [])))


def _members(session: Session, team_ids: list[str]) -> dict[str, list[str]]:
    """The names of the members of these teams, by team."""
    joined = select(TeamMember.team_id, User.name).join(User, User.id == TeamMember.user_id)
    names: dict[str, list[str]] = {}
    for team_id, name in session.execute(joined.where(TeamMember.team_id.in_(team_ids)).order_by(User.name)):
        names.setdefault(team_id, []).append(name)
    return names


def _shown(row: Team, members: list[str]) -> TeamItem:
    return TeamItem(id=row.id, name=row.name, members=members, created_at=instant(row.created_ns))
