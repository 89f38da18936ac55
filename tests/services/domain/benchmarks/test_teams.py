"""Teams: who may let in, that a seat is taken once, and that nobody takes part in a phase with two teams."""

from contextlib import nullcontext
from functools import partial
from hashlib import sha256

import pytest
from sqlalchemy import select, update

from services.domain.benchmarks.teams import teams
from services.domain.benchmarks.teams.errors import (
    AlreadyInTeamError,
    AlreadyMemberError,
    CaptainStaysError,
    InvitationError,
    NotCaptainError,
    NotMemberError,
    TeamFullError,
    TooManyError,
)
from services.runtime.orm import Dataset, Phase, PhaseTeam, Team, TeamInvitation, TeamMember, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from tests.services.domain.benchmarks import laid


@pytest.fixture
def root(platform_on: Platform) -> Person:
    return person(platform_on, "administrator")


@pytest.fixture
def dataset(platform_on: Platform, root: Person) -> Dataset:
    return laid.bare_version(platform_on, root)


@pytest.fixture
def phase(platform_on: Platform, root: Person, dataset: Dataset) -> Phase:
    return laid.phase(platform_on, root, dataset, team_members=2)


@pytest.fixture
def ada(platform_on: Platform) -> User:
    return laid.user(platform_on)


@pytest.fixture
def eve(platform_on: Platform) -> User:
    return laid.user(platform_on)


def invited(platform: Platform, team: Team, captain: User, **said: int) -> str:
    with platform.database.transaction() as session:
        return teams.invite(session, team, captain, **said)


def joined(platform: Platform, secret: str, user: User) -> None:
    with platform.database.transaction() as session:
        teams.join(session, secret, user)


def entered(platform: Platform, phase: Phase, team: Team) -> None:
    with platform.database.transaction() as session:
        teams.enter(session, phase, team.id)


def left(platform: Platform, team: Team, user: User) -> None:
    with platform.database.transaction() as session:
        teams.leave(session, session.get_one(Team, team.id), user)


def bound(platform: Platform) -> set[tuple[str, str]]:
    """(user, team) of everybody who takes part in a phase."""
    return {(row.user_id, row.team_id) for row in laid.rows(platform, select(PhaseTeam))}


def test_an_invitation_lets_one_in_and_only_its_hash_is_kept(platform_on: Platform, ada: User, eve: User) -> None:
    team = laid.team(platform_on, ada)
    secret = invited(platform_on, team, ada)
    joined(platform_on, secret, eve)
    assert laid.members_of(platform_on, team.id) == {ada.id, eve.id}
    row = laid.rows(platform_on, select(TeamInvitation))[0]
    assert (row.secret_hash, row.used_by) == (sha256(secret.encode()).hexdigest(), eve.id)
    with pytest.raises(InvitationError):
        joined(platform_on, secret, laid.user(platform_on))


@pytest.mark.parametrize("secret", ["", "invite_", "invite_" + "x" * 43, "stone_" + "x" * 43, "invite_" + "é" * 43])
def test_what_is_no_invitation_lets_nobody_in(platform: Platform, secret: str) -> None:
    laid.team(platform, laid.user(platform))
    with pytest.raises(InvitationError):
        joined(platform, secret, laid.user(platform))


def test_an_invitation_that_is_too_old_or_withdrawn_lets_nobody_in(platform_on: Platform, ada: User, eve: User) -> None:
    team = laid.team(platform_on, ada)
    old, void = invited(platform_on, team, ada, lasts_ns=0), invited(platform_on, team, ada)
    with platform_on.database.transaction() as session:
        assert [row.expires_ns > now_ns() for row in teams.open_invitations(session, team.id)] == [True]
        assert teams.withdraw(session, team, teams.open_invitations(session, team.id)[0].id)
        assert not teams.withdraw(session, team, "0" * 32)
    for secret in (old, void):
        with pytest.raises(InvitationError):
            joined(platform_on, secret, eve)


def test_a_member_who_accepts_again_leaves_the_invitation_good(platform_on: Platform, ada: User, eve: User) -> None:
    team = laid.team(platform_on, ada)
    secret = invited(platform_on, team, ada)
    with pytest.raises(AlreadyMemberError, match=ada.name):
        joined(platform_on, secret, ada)
    joined(platform_on, secret, eve)


def test_only_the_captain_invites_and_removes_until_it_is_handed_over(
    platform_on: Platform, ada: User, eve: User
) -> None:
    team = laid.team(platform_on, ada, eve)
    with pytest.raises(NotCaptainError, match="invite"):
        invited(platform_on, team, eve)
    with pytest.raises(NotCaptainError), platform_on.database.transaction() as session:
        teams.remove(session, team, eve.id, ada)
    with platform_on.database.transaction() as session:
        teams.hand_over(session, team, eve)
        assert teams.captain(session, team.id) == eve.id
        teams.remove(session, team, eve.id, ada)
    assert laid.members_of(platform_on, team.id) == {eve.id}
    for stranger in (ada, laid.user(platform_on)):
        with pytest.raises(NotMemberError, match=stranger.name), platform_on.database.transaction() as session:
            teams.hand_over(session, team, stranger)


def test_the_captain_leaves_last_and_a_team_of_nobody_is_gone_unless_it_submitted(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    idle, busy = laid.team(platform_on, ada, eve), laid.team(platform_on, ada)
    laid.entry(platform_on, phase.id, busy.id, ada.id)
    with pytest.raises(CaptainStaysError):
        left(platform_on, idle, ada)
    for user, team in ((eve, idle), (ada, idle), (ada, busy)):
        left(platform_on, team, user)
    assert [row.id for row in laid.rows(platform_on, select(Team))] == [busy.id]
    with platform_on.database.reading() as session:
        assert teams.captain(session, busy.id) is None


def test_entering_binds_every_member_and_again_nothing_changes(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team = laid.team(platform_on, ada, eve)
    for _ in range(2):
        entered(platform_on, phase, team)
        assert bound(platform_on) == {(ada.id, team.id), (eve.id, team.id)}


def test_nobody_takes_part_with_two_teams_and_the_refusal_names_nobody(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    first, second = laid.team(platform_on, ada, eve), laid.team(platform_on, laid.user(platform_on), eve)
    entered(platform_on, phase, first)
    with pytest.raises(AlreadyInTeamError) as refused:
        entered(platform_on, phase, second)
    assert eve.name not in str(refused.value)
    assert first.name not in str(refused.value)
    assert bound(platform_on) == {(ada.id, first.id), (eve.id, first.id)}


def test_who_joins_later_takes_part_at_once_or_does_not_join(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team, other = laid.team(platform_on, ada), laid.team(platform_on, eve)
    entered(platform_on, phase, team)
    entered(platform_on, phase, other)
    secret = invited(platform_on, team, ada)
    with pytest.raises(AlreadyInTeamError):
        joined(platform_on, secret, eve)
    assert laid.members_of(platform_on, team.id) == {ada.id}
    new = laid.user(platform_on)
    joined(platform_on, secret, new)
    assert (new.id, team.id) in bound(platform_on)


def test_a_phase_that_has_ended_binds_nobody_who_joins_later(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team = laid.team(platform_on, ada)
    entered(platform_on, phase, team)
    with platform_on.database.transaction() as session:
        session.execute(update(Phase).values(closes_ns=now_ns()))
    joined(platform_on, invited(platform_on, team, ada), eve)
    assert bound(platform_on) == {(ada.id, team.id)}


def test_leaving_a_team_that_scored_leaves_nobody_free_for_another(platform: Platform) -> None:
    root = person(platform, "administrator")
    dataset = laid.bare_version(platform, root)
    binding = {"scored": True, "scoring": True, "queued": True, "invalid": False, "failed": False, "cancelled": False}
    for state, stays in binding.items():
        ada, eve = laid.user(platform), laid.user(platform)
        phase = laid.phase(platform, root, dataset)
        team, other = laid.team(platform, ada, eve), laid.team(platform, laid.user(platform), eve)
        entered(platform, phase, team)
        laid.entry(platform, phase.id, team.id, ada.id, state=state)
        left(platform, team, eve)
        assert ((eve.id, team.id) in bound(platform)) == stays, state
        with pytest.raises(AlreadyInTeamError) if stays else nullcontext():
            entered(platform, phase, other)


def test_a_team_is_as_large_as_the_smallest_phase_it_takes_part_in_allows(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team = laid.team(platform_on, ada, eve)
    entered(platform_on, phase, team)
    secret = invited(platform_on, team, ada)
    with pytest.raises(TeamFullError, match="2 member"):
        joined(platform_on, secret, laid.user(platform_on))
    large = laid.team(platform_on, ada, eve, laid.user(platform_on))
    with pytest.raises(TeamFullError, match="3 member"):
        entered(platform_on, phase, large)


def test_of_several_who_accept_the_last_seat_at_once_one_has_it(platform_on: Platform, phase: Phase, ada: User) -> None:
    team = laid.team(platform_on, ada)
    entered(platform_on, phase, team)
    acts = [partial(teams.join, secret=invited(platform_on, team, ada), user=laid.user(platform_on)) for _ in range(4)]
    assert sorted(laid.at_once(platform_on, *acts)) == ["", *[TeamFullError.code] * 3]
    assert len(laid.members_of(platform_on, team.id)) == 2


def test_of_several_who_accept_one_invitation_at_once_one_is_in(platform_on: Platform, ada: User) -> None:
    team = laid.team(platform_on, ada)
    secret = invited(platform_on, team, ada)
    acts = [partial(teams.join, secret=secret, user=laid.user(platform_on)) for _ in range(4)]
    assert sorted(laid.at_once(platform_on, *acts)) == ["", *[InvitationError.code] * 3]
    assert len(laid.members_of(platform_on, team.id)) == 2


def test_who_joins_two_teams_of_one_phase_at_once_is_in_one(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    captains = [laid.user(platform_on) for _ in range(3)]
    of_phase = [laid.team(platform_on, captain) for captain in captains]
    for team in of_phase:
        entered(platform_on, phase, team)
    secrets = [invited(platform_on, *pair) for pair in zip(of_phase, captains, strict=True)]
    codes = laid.at_once(platform_on, *[partial(teams.join, secret=secret, user=eve) for secret in secrets])
    assert sorted(codes) == ["", *[AlreadyInTeamError.code] * 2]
    memberships = laid.rows(platform_on, select(TeamMember.team_id).where(TeamMember.user_id == eve.id))
    assert {(eve.id, team_id) for team_id in memberships} == {pair for pair in bound(platform_on) if pair[0] == eve.id}


def test_teams_that_share_members_and_enter_at_once_do_not_both(
    platform_on: Platform, phase: Phase, ada: User, eve: User
) -> None:
    both = [laid.team(platform_on, ada, eve), laid.team(platform_on, eve, ada)]
    codes = laid.at_once(platform_on, *[partial(teams.enter, phase=phase, team_id=team.id) for team in both])
    assert sorted(codes) == ["", AlreadyInTeamError.code]
    assert len({team_id for _, team_id in bound(platform_on)}) == 1


def test_teams_and_invitations_are_bounded(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(teams, "MOST_TEAMS", 2)
    monkeypatch.setattr(teams, "MOST_INVITATIONS", 1)
    ada, eve = laid.user(platform), laid.user(platform)
    team, _second, third = laid.team(platform, ada), laid.team(platform, ada), laid.team(platform, eve)
    with pytest.raises(TooManyError, match="2 teams"):
        laid.team(platform, ada)
    secret = invited(platform, third, eve)
    with pytest.raises(TooManyError, match="2 teams"):
        joined(platform, secret, ada)
    invited(platform, team, ada)
    with pytest.raises(TooManyError, match="1 open invitations"):
        invited(platform, team, ada)
