"""Teams as the API shows them."""

from collections.abc import Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.people import TeamItem
from services.runtime.orm import PhaseTeam, Team, TeamMember, User


def team_items(session: Session, rows: Sequence[Team]) -> list[TeamItem]:
    """Return teams with the names of their members and their phases, by two statements for all teams."""
    ids = [row.id for row in rows]
    joined = select(TeamMember.team_id, User.name, TeamMember.is_owner).join(User, User.id == TeamMember.user_id)
    members: dict[str, list[str]] = {}
    captains: dict[str, str] = {}
    for team_id, name, is_owner in session.execute(joined.where(TeamMember.team_id.in_(ids)).order_by(User.name)):
        members.setdefault(team_id, []).append(name)
        captains |= {team_id: name} if is_owner else {}
    bound = select(PhaseTeam.team_id, PhaseTeam.phase_id).where(PhaseTeam.team_id.in_(ids)).distinct()
    phases: dict[str, list[str]] = {}
    for team_id, phase_id in session.execute(bound.order_by(PhaseTeam.phase_id)):
        phases.setdefault(team_id, []).append(phase_id)
    return [
        TeamItem.of(row, captain=captains.get(row.id), members=members.get(row.id, []), phases=phases.get(row.id, []))
        for row in rows
    ]
