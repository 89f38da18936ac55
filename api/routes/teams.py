"""Routes of teams: create, invite, join, leave, hand over.

**Conventions.** A captain invites, removes and hands over; administrators may remove and hand over too, and say why.
The secret of an invitation is in the answer to its making and nowhere else. A member leaves by removing themselves.
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Response
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Caller, PlatformDep, require
from api.errors import NotFoundError
from api.paging import Page, PageDep, page, whole
from api.schemas.base import IdPath
from api.schemas.people import TeamBody, TeamItem
from api.schemas.teams import (
    CaptainBody,
    InvitationBody,
    InvitationItem,
    IssuedInvitation,
    JoinBody,
    MemberName,
    ReasonQuery,
)
from api.views.teams import team_items
from api.visible import team_of, teams_of
from services.domain.benchmarks.teams import teams
from services.runtime.access.users import find_user
from services.runtime.orm import Team, User
from stone.errors import Refused

router = APIRouter(prefix="/teams", tags=["people"])
Participant = Annotated[Caller, Depends(require("submit"))]
Reader = Annotated[Caller, Depends(require("read"))]


@router.post("", status_code=201, summary="Create a team", responses=refusals(409))
def create_team(body: TeamBody, caller: Participant, platform: PlatformDep) -> TeamItem:
    """Create a team with the caller as its captain. Names that look alike count as equal."""
    with platform.database.transaction() as session:
        team = teams.create_team(session, body.name, caller.user_id)
        audit.record(session, caller, "team.found", team.id, facts={"name": team.name})
        return team_items(session, [team])[0]


@router.get("", summary="List your teams, newest first")
def list_teams(caller: Reader, query: PageDep, platform: PlatformDep) -> Page[TeamItem]:
    """List your teams; administrators see all teams."""
    with platform.database.reading() as session:
        rows = page(session, teams_of(caller), Team.id.desc(), query)
        return Page[TeamItem](items=team_items(session, rows.rows), next=rows.next)


@router.post("/memberships", status_code=201, summary="Join a team by invitation", responses=refusals(404))
def join_team(body: JoinBody, caller: Participant, platform: PlatformDep) -> TeamItem:
    """Add the caller, who takes part in all phases of the team that have not ended."""
    with platform.database.transaction() as session:
        team = teams.join(session, body.secret, session.get_one(User, caller.user_id))
        audit.record(session, caller, "team.join", team.id)
        return team_items(session, [team])[0]


@router.get("/{team_id}", responses=refusals(404))
def show_team(team_id: IdPath, caller: Reader, platform: PlatformDep) -> TeamItem:
    """Show one of your teams; administrators see any team."""
    with platform.database.reading() as session:
        return team_items(session, [team_of(session, caller, team_id)])[0]


@router.post("/{team_id}/invitations", status_code=201, responses=refusals(404))
def create_invitation(
    team_id: IdPath, body: InvitationBody, caller: Participant, platform: PlatformDep, response: Response
) -> IssuedInvitation:
    """Create a single-use invitation. Requires the captain."""
    with platform.database.transaction() as session:
        team = team_of(session, caller, team_id)
        row, secret = teams.invite_row(session, team, caller.user_id, body.expires_s * 10**9)
        audit.record(session, caller, "team.invite", team.id, facts={"invitation_id": row.id})
    response.headers["Cache-Control"] = "no-store"
    return IssuedInvitation.of(row, secret=secret)


@router.get("/{team_id}/invitations", responses=refusals(404))
def list_invitations(team_id: IdPath, caller: Reader, platform: PlatformDep) -> Page[InvitationItem]:
    """List the open invitations, oldest first."""
    with platform.database.reading() as session:
        rows = teams.open_invitations(session, team_of(session, caller, team_id).id)
        return whole([InvitationItem.of(row) for row in rows])


@router.delete("/{team_id}/invitations/{invitation_id}", status_code=204, responses=refusals(404))
def withdraw_invitation(team_id: IdPath, invitation_id: IdPath, caller: Participant, platform: PlatformDep) -> None:
    """Withdraw an open invitation. Requires the captain."""
    with platform.database.transaction() as session:
        team = team_of(session, caller, team_id)
        teams.refuse_others(session, team.id, caller.user_id, "withdraw an invitation")
        if not teams.withdraw(session, team, invitation_id):
            raise NotFoundError("open invitation", invitation_id)
        audit.record(session, caller, "team.uninvite", team.id, facts={"invitation_id": invitation_id})


@router.delete(
    "/{team_id}/members/{member}",
    summary="Leave a team, or remove a member",
    status_code=204,
    responses=refusals(404, 409),
)
def remove_member(
    team_id: IdPath, member: MemberName, caller: Participant, platform: PlatformDep, reason: ReasonQuery = ""
) -> None:
    """Remove the member. Scored submissions stay with the team, and the member still counts as its member in their
    phases.
    """
    with platform.database.transaction() as session:
        team = team_of(session, caller, team_id)
        if member != caller.name:
            _lead(session, caller, team, ("team.remove", reason, {"member": member}))
        else:
            audit.record(session, caller, "team.leave", team.id)
        teams.leave(session, team, _member(session, member))


@router.put("/{team_id}/captain", responses=refusals(404, 409))
def change_captain(team_id: IdPath, body: CaptainBody, caller: Participant, platform: PlatformDep) -> TeamItem:
    """Make another member the captain."""
    with platform.database.transaction() as session:
        team = team_of(session, caller, team_id)
        _lead(session, caller, team, ("team.hand_over", body.reason or "", {"member": body.member}))
        teams.hand_over(session, team, _member(session, body.member))
        return team_items(session, [team])[0]


def _lead(session: Session, caller: Caller, team: Team, act: tuple[str, str, dict[str, str]]) -> None:
    """Record an act of the captain, or of an administrator with a reason. Raises `not_captain`, `reason_missing`."""
    name, reason, facts = act
    teams.lock_team(session, team.id)
    if caller.is_administrator and teams.captain(session, team.id) != caller.user_id:
        audit.record_admin_act(session, caller, name, team.id, reason, facts)
        return
    teams.refuse_others(session, team.id, caller.user_id, "remove members or hand it over")
    audit.record(session, caller, name, team.id, reason, facts)


def _member(session: Session, name: str) -> User:
    """Return the user. An unknown name raises `not_member`, as for a user outside the team."""
    user = find_user(session, name)
    if user is None:
        raise Refused("not_member", f"{name[:64]!r} is no member of this team")
    return user
