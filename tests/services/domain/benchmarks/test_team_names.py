"""Names of teams: none that passes for another, none that no row can hold."""

from functools import partial

import pytest

from services.domain.benchmarks.teams import names as team_names
from services.domain.benchmarks.teams import teams
from services.runtime.access.errors import NameTakenError
from services.runtime.platform import Platform
from tests.services.domain.benchmarks import laid


def test_names_that_look_alike_are_one(platform: Platform) -> None:
    ada = laid.user(platform)
    with platform.database.transaction() as session:
        teams.found(session, "Terrain Gang", ada.id)
    alike = ("terrain gang", "TERRAIN  GANG", "\uff34errain Gang", "Terrain\u00a0Gang", "Terrain\u3164 Gang\ufe0f")
    for other in alike:
        with pytest.raises(NameTakenError), platform.database.transaction() as session:
            teams.found(session, other, ada.id)


def test_names_are_kept_composed_and_other_names_are_free(platform: Platform) -> None:
    ada = laid.user(platform)
    with platform.database.transaction() as session:
        assert teams.found(session, "Équipe", ada.id).name == "Équipe"
        assert teams.found(session, "Equipe", ada.id).name == "Equipe"
    assert team_names.folded("E\u0301QUIPE") == team_names.folded("équipe")


def test_a_name_of_nothing_that_is_seen_or_too_long_when_composed_is_refused(platform: Platform) -> None:
    ada = laid.user(platform)
    for name, counted in (("\u3164\ufe0f", "2 .* 0 "), ("\u0958" * 33, "66 .* 66 ")):
        with (
            pytest.raises(team_names.BadTeamNameError, match=counted),
            platform.database.transaction() as session,
        ):
            teams.found(session, name, ada.id)


def test_of_teams_founded_at_once_with_names_that_look_alike_one_stands(platform_on: Platform) -> None:
    ada = laid.user(platform_on)
    acts = [partial(teams.found, name=name, user_id=ada.id) for name in ("Gang", "GANG", "gang")]
    assert sorted(laid.at_once(platform_on, *acts)) == ["", *[NameTakenError.code] * 2]
