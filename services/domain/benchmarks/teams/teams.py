"""Teams: created, joined by invitation, led by a captain, left, and bound to the phases they take part in.

**Conventions.** Exactly one member is the captain (`TeamMember.is_owner`). An invitation is a secret of 32 random
bytes, shown once, stored as sha256, and valid for one joining until it expires. A user takes part in a phase with one
team only (primary key of `phase_teams`). `enter` binds all members; a new member is bound immediately in all phases
that have not ended. A binding outlives leaving if the team has a scored or pending submission in the phase. Every
function is part of the caller's transaction and locks the team's row (PostgreSQL `FOR NO KEY UPDATE`).
"""

import re
from hashlib import sha256
from secrets import token_urlsafe

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.phases import DAY_NS, MOST_MEMBERS, phase_status
from services.domain.benchmarks.teams.errors import already_in_team
from services.domain.benchmarks.teams.names import reserve_name
from services.runtime.database.inserts import insert_new
from services.runtime.orm import Phase, PhaseTeam, ScoringEntry, SubmissionRow, Team, TeamInvitation, TeamMember, User
from services.runtime.orm.base import now_ns
from stone.errors import Refused

PREFIX = "invite_"
SECRET = re.compile(r"invite_[A-Za-z0-9_-]{43}")
LASTS_NS = 14 * DAY_NS
MOST_TEAMS = 50
MOST_INVITATIONS = 100
BINDING = ("queued", "scoring", "scored")


def create_team(session: Session, name: str, user_id: str) -> Team:
    """Create a team with this user as its captain. Raises `bad_team_name`, `name_taken`, `too_many`."""
    team = Team(name=reserve_name(session, name))
    _refuse_many_teams(session, user_id)
    session.add(team)
    session.flush()
    session.add(TeamMember(team_id=team.id, user_id=user_id, is_owner=True))
    session.flush()
    return team


def captain(session: Session, team_id: str) -> str | None:
    """Return the id of the team's captain; None for a team without members."""
    led = select(TeamMember.user_id).where(TeamMember.team_id == team_id, TeamMember.is_owner)
    return session.scalars(led).one_or_none()


def is_member(session: Session, team_id: str, user_id: str) -> bool:
    return session.get(TeamMember, (team_id, user_id)) is not None


def invite(session: Session, team: Team, user: User, lasts_ns: int = LASTS_NS) -> str:
    """Return the secret of a new invitation by the captain, which cannot be shown again. Raises as `invite_row`."""
    return invite_row(session, team, user.id, lasts_ns)[1]


def invite_row(session: Session, team: Team, user_id: str, lasts_ns: int = LASTS_NS) -> tuple[TeamInvitation, str]:
    """Return the row and the secret of a new invitation. Raises `not_captain`, `too_many`."""
    lock_team(session, team.id)
    refuse_others(session, team.id, user_id, "invite")
    if len(open_invitations(session, team.id)) >= MOST_INVITATIONS:
        raise too_many("open invitations", MOST_INVITATIONS)
    secret = PREFIX + token_urlsafe(32)
    row = TeamInvitation(team_id=team.id, secret_hash=_hash(secret), created_by=user_id, expires_ns=now_ns() + lasts_ns)
    session.add(row)
    session.flush()
    return row, secret


def open_invitations(session: Session, team_id: str) -> list[TeamInvitation]:
    """Return the valid invitations, oldest first."""
    of_team = select(TeamInvitation).where(TeamInvitation.team_id == team_id, TeamInvitation.used_ns.is_(None))
    return list(session.scalars(of_team.where(TeamInvitation.expires_ns > now_ns()).order_by(TeamInvitation.id)))


def withdraw(session: Session, team: Team, invitation_id: str) -> bool:
    """Revoke an open invitation of the team; return whether it existed."""
    lock_team(session, team.id)
    row = next((row for row in open_invitations(session, team.id) if row.id == invitation_id), None)
    if row is not None:
        session.delete(row)
        session.flush()
    return row is not None


def join(session: Session, secret: str, user: User) -> Team:
    """Add the user to the invitation's team, and bind the user to the phases that the team takes part in.

    Raises `no_invitation`, `already_member`, `team_full`, `already_in_team`, `too_many`; the invitation then stays
    valid.
    """
    named = select(TeamInvitation).where(TeamInvitation.secret_hash == _hash(secret))
    row = session.scalars(named).one_or_none() if SECRET.fullmatch(secret) else None
    if row is None:
        raise no_invitation()
    team = lock_team(session, row.team_id)
    invitation = session.scalars(named.execution_options(populate_existing=True)).one_or_none()
    if invitation is None or invitation.used_ns is not None or invitation.expires_ns <= now_ns():
        raise no_invitation()
    if is_member(session, team.id, user.id):
        raise Refused("already_member", f"{user.name!r} is already a member of this team; the invitation was not used")
    _refuse_many_teams(session, user.id)
    phases = _open_phases_of(session, team.id)
    _refuse_full(session, team.id, phases)
    session.add(TeamMember(team_id=team.id, user_id=user.id))
    invitation.used_by, invitation.used_ns = user.id, now_ns()
    session.flush()
    for phase in phases:
        _bind(session, phase, team.id, [user.id])
    return team


def enter(session: Session, phase: Phase, team_id: str) -> None:
    """Bind every member to the team in this phase; a second call has no effect.

    Raises `already_in_team` if a member takes part with another team, `team_full` if the team has too many members.
    """
    lock_team(session, team_id)
    members = _member_ids(session, team_id)
    if len(members) > phase.team_members:
        raise team_full(len(members), phase.team_members)
    _bind(session, phase, team_id, members)


def leave(session: Session, team: Team, user: User) -> None:
    """Remove the user; when the last member leaves, the team is deleted unless it has submissions.

    Raises `not_member`, `captain_cannot_leave`.
    """
    lock_team(session, team.id)
    member = _member(session, team.id, user)
    others = len(_member_ids(session, team.id)) - 1
    if member.is_owner and others:
        raise Refused(
            "captain_cannot_leave",
            "the captain cannot leave while there are other members; make another member the captain first",
        )
    session.delete(member)
    session.flush()
    _unbind(session, team.id, user.id)
    if not others and not _has_records(session, team.id):
        session.delete(team)
        session.flush()


def remove(session: Session, team: Team, by: str, user: User) -> None:
    """Remove another member, on behalf of the captain, whose id is `by`. Raises `not_captain` and as `leave`."""
    lock_team(session, team.id)
    refuse_others(session, team.id, by, "remove a member")
    leave(session, team, user)


def hand_over(session: Session, team: Team, user: User) -> None:
    """Make another member the captain. Raises `not_member`."""
    lock_team(session, team.id)
    member = _member(session, team.id, user)
    for row in session.scalars(select(TeamMember).where(TeamMember.team_id == team.id, TeamMember.is_owner)):
        row.is_owner = False
    member.is_owner = True
    session.flush()


def lock_team(session: Session, team_id: str) -> Team:
    """Return the current team, with its row locked until the end of the transaction."""
    locked = select(Team).where(Team.id == team_id).with_for_update(key_share=True)
    return session.scalars(locked.execution_options(populate_existing=True)).one()


def refuse_others(session: Session, team_id: str, user_id: str, act: str) -> None:
    """Raise `not_captain` if the user does not lead the team."""
    if captain(session, team_id) != user_id:
        raise Refused("not_captain", f"only the team's captain may {act}")


def _bind(session: Session, phase: Phase, team_id: str, user_ids: list[str]) -> None:
    """Bind the users to the team in the phase; the order of ids prevents deadlocks."""
    values = [{"phase_id": phase.id, "user_id": user_id, "team_id": team_id} for user_id in sorted(user_ids)]
    insert_new(session, PhaseTeam, values)
    bound = select(PhaseTeam.team_id).where(PhaseTeam.phase_id == phase.id, PhaseTeam.user_id.in_(user_ids))
    if any(other != team_id for other in session.scalars(bound)):
        raise already_in_team(phase.name)


def _unbind(session: Session, team_id: str, user_id: str) -> None:
    """Release the user's bindings in phases where this team has no scored or pending submission."""
    scored = select(SubmissionRow.phase_id).where(SubmissionRow.team_id == team_id, SubmissionRow.state.in_(BINDING))
    bound = (PhaseTeam.team_id == team_id, PhaseTeam.user_id == user_id)
    session.execute(delete(PhaseTeam).where(*bound, PhaseTeam.phase_id.not_in(scored)))


def _open_phases_of(session: Session, team_id: str) -> list[Phase]:
    """Return the unfinished phases in which the team takes part, by id."""
    bound = select(PhaseTeam.phase_id).where(PhaseTeam.team_id == team_id)
    phases = session.scalars(select(Phase).where(Phase.id.in_(bound)).order_by(Phase.id))
    return [phase for phase in phases if phase_status(phase, now_ns()) != "closed"]


def _refuse_full(session: Session, team_id: str, phases: list[Phase]) -> None:
    members = len(_member_ids(session, team_id))
    most = min((phase.team_members for phase in phases), default=MOST_MEMBERS)
    if members >= most:
        raise team_full(members, most)


def _refuse_many_teams(session: Session, user_id: str) -> None:
    counted = select(func.count()).select_from(TeamMember).where(TeamMember.user_id == user_id)
    if (session.scalar(counted) or 0) >= MOST_TEAMS:
        raise too_many("teams of yours", MOST_TEAMS)


def _member(session: Session, team_id: str, user: User) -> TeamMember:
    row = session.get(TeamMember, (team_id, user.id), populate_existing=True)
    if row is None:
        raise Refused("not_member", f"{user.name[:64]!r} is not a member of this team")
    return row


def _member_ids(session: Session, team_id: str) -> list[str]:
    return list(session.scalars(select(TeamMember.user_id).where(TeamMember.team_id == team_id)))


def _has_records(session: Session, team_id: str) -> bool:
    """Return whether the team has submissions or granted scorings."""
    ledgers = (select(row.id).where(row.team_id == team_id).limit(1) for row in (SubmissionRow, ScoringEntry))
    return any(session.scalar(ledger) is not None for ledger in ledgers)


def _hash(secret: str) -> str:
    return sha256(secret.encode()).hexdigest()


def no_invitation() -> Refused:
    return Refused(
        "no_invitation",
        "this invitation is unknown, used, withdrawn or expired; ask the captain for another invitation",
    )


def team_full(members: int, most: int) -> Refused:
    return Refused(
        "team_full", f"the team has {members} member(s), but a phase in which it takes part allows at most {most}"
    )


def too_many(kind: str, most: int) -> Refused:
    return Refused("too_many", f"the limit of {most} {kind} is reached; remove some that are not needed")
