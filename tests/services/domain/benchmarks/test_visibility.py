"""Who sees what of a submission: every cell of viewer × phase × field, from the queries up; and who knows of none."""

from typing import Any

import pytest
from sqlalchemy import select

from services.domain.benchmarks.submissions.result_errors import NotScoredError, ScoreMissingError
from services.domain.benchmarks.submissions.results import readable_scores, seen_score, submission_seen
from services.domain.benchmarks.visibility import ANYBODY, Viewer, secrecy_of, submissions_seen, viewer_of
from services.runtime.orm import Phase, SubmissionRow, TeamMember
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, HOUR_NS, Made, Scene, scene
from tests.services.domain.benchmarks.seen_fields import RELATIONS, STANDINGS, expected, seen_fields


def standing(at: Scene, name: str) -> None:
    """Bring the phase to stand so."""
    if name == "running":
        at.hide(opens_ns=1, closes_ns=now_ns() + HOUR_NS)
    elif name == "ended":
        at.end()
    elif name == "unnamed":
        at.change(at.phase_id, Phase, named_from_ns=now_ns() + HOUR_NS)


@pytest.mark.parametrize("name", STANDINGS)
def test_every_viewer_sees_exactly_what_the_table_says(platform: Platform, name: str) -> None:
    at = scene(platform)
    team = at.team()
    mine = at.enter(team, Made(0.3), description="How it is done")
    other = at.enter(at.team(), Made(0.4))
    standing(at, name)
    viewers = {"a": ADMINISTRATOR, "m": Viewer(team_ids=frozenset({team})), "o": ANYBODY}
    for relation in RELATIONS:
        assert seen_fields(at, (mine, other), viewers[relation]) == expected(name, relation), relation


@pytest.mark.parametrize(
    ("columns", "secrecy"),
    [
        ({"is_hidden": False, "closes_ns": 5}, "open"),
        ({"is_hidden": True, "closes_ns": None}, "running"),
        ({"is_hidden": True, "closes_ns": 11}, "running"),
        ({"is_hidden": True, "closes_ns": 10}, "ended"),
        ({"is_hidden": True, "opens_ns": 20, "closes_ns": 30}, "running"),
    ],
)
def test_a_hidden_truth_is_told_of_from_the_end_on_and_not_before(columns: dict[str, Any], secrecy: str) -> None:
    assert secrecy_of(Phase(**columns), now_ns=10) == secrecy


NOT_ON_BOARDS: tuple[dict[str, Any], ...] = (
    {"withdrawn_ns": 1},
    {"hidden_ns": 1, "hidden_reason": "copied"},
    {"kind": "validation", "state": "valid"},
    *({"state": state} for state in ("draft", "queued", "scoring", "valid", "invalid", "failed", "cancelled")),
)


@pytest.mark.parametrize("name", STANDINGS)
def test_what_is_not_on_the_board_is_its_teams_only(platform: Platform, name: str) -> None:
    at = scene(platform)
    teams = [at.team() for _ in NOT_ON_BOARDS]
    ids = [at.enter(team, Made(0.3), **columns) for team, columns in zip(teams, NOT_ON_BOARDS, strict=True)]
    standing(at, name)
    stranger = Viewer(team_ids=frozenset({at.team()}))
    for team, submission_id in zip(teams, ids, strict=True):
        viewers = (ADMINISTRATOR, Viewer(team_ids=frozenset({team})), stranger, ANYBODY)
        with platform.database.reading() as session:
            seen = [submission_seen(session, viewer, submission_id) is not None for viewer in viewers]
            listed = [submission_id in {row.id for row in session.scalars(submissions_seen(one))} for one in viewers]
        assert seen == listed == [True, True, False, False]


def test_what_is_on_the_board_is_everybodys_to_know_of(platform: Platform) -> None:
    at = scene(platform)
    known = {at.enter(at.team(), Made(0.3)), at.enter(at.team(), Made(0.3), kind="baseline")}
    at.enter(at.team(), Made(0.3), kind="validation")
    with platform.database.reading() as session:
        assert {row.id for row in session.scalars(submissions_seen(ANYBODY))} == known


def test_a_viewer_has_the_teams_they_are_in_now(platform: Platform) -> None:
    at = scene(platform)
    team, user_id = at.team(), at.place.user.id
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=team, user_id=user_id))
    with platform.database.transaction() as session:
        assert viewer_of(session, user_id, False) == Viewer(False, frozenset({team}))
        session.delete(session.scalars(select(TeamMember)).one())
        session.flush()
        assert viewer_of(session, user_id, False) == ANYBODY


def test_a_score_by_a_pair_that_was_never_in_force_is_nobodys_but_administrators(platform: Platform) -> None:
    at = scene(platform)
    team = at.team()
    submission_id = at.enter(team, Made(0.4))
    pending = at.score(submission_id, Made(0.2), at.another_pair())
    with platform.database.reading() as session:
        row = session.get_one(SubmissionRow, submission_id)
        for viewer in (ANYBODY, Viewer(team_ids=frozenset({team}))):
            assert len(readable_scores(session, viewer, row)) == 1
            with pytest.raises(ScoreMissingError):
                seen_score(session, viewer, row, pending)
        assert len(readable_scores(session, ADMINISTRATOR, row)) == 2
        assert not seen_score(session, ADMINISTRATOR, row, pending).is_active


def test_a_score_of_another_submission_is_not_found_by_its_id(platform: Platform) -> None:
    at = scene(platform)
    one, other = (at.enter(at.team(), Made(error)) for error in (0.3, 0.4))
    with platform.database.reading() as session:
        row = session.get_one(SubmissionRow, one)
        with pytest.raises(ScoreMissingError):
            seen_score(session, ADMINISTRATOR, row, at.score_row(other).id)


def test_what_has_no_score_says_how_far_it_is(platform: Platform) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), None, state="scoring")
    with platform.database.reading() as session, pytest.raises(NotScoredError):
        seen_score(session, ADMINISTRATOR, session.get_one(SubmissionRow, submission_id))
