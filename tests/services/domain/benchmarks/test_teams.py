"""Teams: who may let in, how large they get, that nobody takes part with two, that no name passes for another."""

from contextlib import nullcontext
from hashlib import sha256

import pytest
from sqlalchemy import select, update

from services.domain.benchmarks.teams import names as team_names
from services.domain.benchmarks.teams import teams
from services.runtime.orm import Phase, PhaseTeam, Team, TeamInvitation, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.refusals import refused_as
from tests.services.domain.benchmarks import laid


@pytest.fixture
def phase(platform: Platform) -> Phase:
    return laid.hidden_phase(platform, team_members=2)


@pytest.fixture
def ada(platform: Platform) -> User:
    return laid.user(platform)


@pytest.fixture
def eve(platform: Platform) -> User:
    return laid.user(platform)


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


def test_an_invitation_lets_one_in_and_only_its_hash_is_kept(platform: Platform, ada: User, eve: User) -> None:
    team = laid.team(platform, ada)
    secret = invited(platform, team, ada)
    joined(platform, secret, eve)
    assert laid.members_of(platform, team.id) == {ada.id, eve.id}
    row = laid.rows(platform, select(TeamInvitation))[0]
    assert (row.secret_hash, row.used_by) == (sha256(secret.encode()).hexdigest(), eve.id)
    with refused_as("no_invitation"):
        joined(platform, secret, laid.user(platform))


def test_what_is_no_invitation_lets_nobody_in(platform: Platform, ada: User, eve: User) -> None:
    laid.team(platform, ada)
    for secret in ("", "invite_", "invite_" + "x" * 43, "stone_" + "x" * 43, "invite_" + "é" * 43):
        with refused_as("no_invitation"):
            joined(platform, secret, eve)


def test_an_invitation_that_is_too_old_or_withdrawn_lets_nobody_in(platform: Platform, ada: User, eve: User) -> None:
    team = laid.team(platform, ada)
    old, void = invited(platform, team, ada, lasts_ns=0), invited(platform, team, ada)
    with platform.database.transaction() as session:
        assert [row.expires_ns > now_ns() for row in teams.open_invitations(session, team.id)] == [True]
        assert teams.withdraw(session, team, teams.open_invitations(session, team.id)[0].id)
        assert not teams.withdraw(session, team, "0" * 32)
    for secret in (old, void):
        with refused_as("no_invitation"):
            joined(platform, secret, eve)


def test_a_member_who_accepts_again_leaves_the_invitation_good(platform: Platform, ada: User, eve: User) -> None:
    secret = invited(platform, laid.team(platform, ada), ada)
    with refused_as("already_member"):
        joined(platform, secret, ada)
    joined(platform, secret, eve)


def test_only_the_captain_invites_and_removes_until_it_is_handed_over(platform: Platform, ada: User, eve: User) -> None:
    team = laid.team(platform, ada, eve)
    with refused_as("not_captain"):
        invited(platform, team, eve)
    with refused_as("not_captain"), platform.database.transaction() as session:
        teams.remove(session, team, eve.id, ada)
    with platform.database.transaction() as session:
        teams.hand_over(session, team, eve)
        assert teams.captain(session, team.id) == eve.id
        teams.remove(session, team, eve.id, ada)
    assert laid.members_of(platform, team.id) == {eve.id}
    for stranger in (ada, laid.user(platform)):
        with refused_as("not_member", match=stranger.name), platform.database.transaction() as session:
            teams.hand_over(session, team, stranger)


def test_the_captain_leaves_last_and_a_team_of_nobody_is_gone_unless_it_submitted(
    platform: Platform, phase: Phase, ada: User, eve: User
) -> None:
    idle, busy = laid.team(platform, ada, eve), laid.team(platform, ada)
    laid.entry(platform, phase.id, busy.id, ada.id)
    with refused_as("captain_cannot_leave"):
        left(platform, idle, ada)
    for user, team in ((eve, idle), (ada, idle), (ada, busy)):
        left(platform, team, user)
    assert [row.id for row in laid.rows(platform, select(Team))] == [busy.id]
    with platform.database.reading() as session:
        assert teams.captain(session, busy.id) is None


def test_nobody_takes_part_with_two_teams_and_the_refusal_names_nobody(
    platform: Platform, phase: Phase, ada: User, eve: User
) -> None:
    first, second = laid.team(platform, ada, eve), laid.team(platform, laid.user(platform), eve)
    for _ in range(2):
        entered(platform, phase, first)
        assert bound(platform) == {(ada.id, first.id), (eve.id, first.id)}
    with refused_as("already_in_team") as refused:
        entered(platform, phase, second)
    assert eve.name not in str(refused.value)
    assert first.name not in str(refused.value)
    assert bound(platform) == {(ada.id, first.id), (eve.id, first.id)}


def test_who_joins_later_takes_part_at_once_or_does_not_join(
    platform: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team, other = laid.team(platform, ada), laid.team(platform, eve)
    entered(platform, phase, team)
    entered(platform, phase, other)
    secret = invited(platform, team, ada)
    with refused_as("already_in_team"):
        joined(platform, secret, eve)
    assert laid.members_of(platform, team.id) == {ada.id}
    new = laid.user(platform)
    joined(platform, secret, new)
    assert (new.id, team.id) in bound(platform)


def test_a_phase_that_has_ended_binds_nobody_who_joins_later(
    platform: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team = laid.team(platform, ada)
    entered(platform, phase, team)
    with platform.database.transaction() as session:
        session.execute(update(Phase).values(closes_ns=now_ns()))
    joined(platform, invited(platform, team, ada), eve)
    assert bound(platform) == {(ada.id, team.id)}


def test_leaving_a_team_that_scored_leaves_nobody_free_for_another(platform: Platform) -> None:
    binding = {"scored": True, "scoring": True, "queued": True, "invalid": False, "failed": False, "cancelled": False}
    for state, stays in binding.items():
        ada, eve = laid.user(platform), laid.user(platform)
        phase = laid.hidden_phase(platform)
        team, other = laid.team(platform, ada, eve), laid.team(platform, laid.user(platform), eve)
        entered(platform, phase, team)
        laid.entry(platform, phase.id, team.id, ada.id, state=state)
        left(platform, team, eve)
        assert ((eve.id, team.id) in bound(platform)) == stays, state
        with refused_as("already_in_team") if stays else nullcontext():
            entered(platform, phase, other)


def test_a_team_is_as_large_as_the_smallest_phase_it_takes_part_in_allows(
    platform: Platform, phase: Phase, ada: User, eve: User
) -> None:
    team = laid.team(platform, ada, eve)
    entered(platform, phase, team)
    secret = invited(platform, team, ada)
    with refused_as("team_full", match="2 member"):
        joined(platform, secret, laid.user(platform))
    large = laid.team(platform, ada, eve, laid.user(platform))
    with refused_as("team_full", match="3 member"):
        entered(platform, phase, large)


def test_teams_and_invitations_are_bounded(
    platform: Platform, ada: User, eve: User, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(teams, "MOST_TEAMS", 2)
    monkeypatch.setattr(teams, "MOST_INVITATIONS", 1)
    team, _second, third = laid.team(platform, ada), laid.team(platform, ada), laid.team(platform, eve)
    with refused_as("too_many", match="2 teams"):
        laid.team(platform, ada)
    secret = invited(platform, third, eve)
    with refused_as("too_many", match="2 teams"):
        joined(platform, secret, ada)
    invited(platform, team, ada)
    with refused_as("too_many", match="1 open invitations"):
        invited(platform, team, ada)


def test_names_that_look_alike_are_one_and_others_are_kept_composed(platform: Platform, ada: User) -> None:
    with platform.database.transaction() as session:
        teams.create_team(session, "Terrain Gang", ada.id)
        assert teams.create_team(session, "Équipe", ada.id).name == "Équipe"
        assert teams.create_team(session, "Equipe", ada.id).name == "Equipe"
    assert team_names.folded("E\u0301QUIPE") == team_names.folded("équipe")
    alike = ("terrain gang", "TERRAIN  GANG", "\uff34errain Gang", "Terrain\u00a0Gang", "Terrain\u3164 Gang\ufe0f")
    for other in alike:
        with refused_as("name_taken"), platform.database.transaction() as session:
            teams.create_team(session, other, ada.id)


def test_a_name_of_nothing_that_is_seen_or_too_long_when_composed_is_refused(platform: Platform, ada: User) -> None:
    for name, counted in (("\u3164\ufe0f", "2 .* 0 "), ("\u0958" * 33, "66 .* 66 ")):
        with refused_as("bad_team_name", match=counted), platform.database.transaction() as session:
            teams.create_team(session, name, ada.id)
