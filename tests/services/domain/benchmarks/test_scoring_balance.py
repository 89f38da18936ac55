"""The balance of scorings: whatever is released and retaken, a submission holds one scoring or none."""

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.errors import ScoringsExhaustedError
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.drafts import Entrant, a_submission, another_phase, entrant_on, reserved, standing

DAY_NS = 86_400 * 10**9
NOW_NS = 1_800_000_000 * 10**9


@pytest.fixture
def counted(platform: Platform) -> Entrant:
    return entrant_on(platform)


def test_what_was_reserved_before_the_window_and_is_retaken_in_it_is_counted(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The attack: an old submission that is given back and scored again, at no cost of this window."""
    entrant = entrant_on(platform, scorings_per_window=1, window_ns=7 * DAY_NS)
    old = reserved(entrant)
    monkeypatch.setattr(scoring_quota, "now_ns", lambda: now_ns() + 8 * DAY_NS)
    with platform.database.transaction() as session:
        assert scoring_quota.release(session, old, "released: failed") == 1
        assert scoring_quota.retake(session, old) == 1
    later = now_ns() + 8 * DAY_NS
    assert (standing(entrant, later).reserved, standing(entrant, later + 8 * DAY_NS).reserved) == (1, 0)
    with pytest.raises(ScoringsExhaustedError):
        reserved(entrant)


STEPS = st.lists(
    st.tuples(st.sampled_from(["reserve", "release", "retake", "consume", "wait"]), st.integers(0, 2)), max_size=14
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(steps=STEPS)
@example(steps=[("reserve", 0), ("wait", 2), ("release", 0), ("retake", 0)])
def test_whatever_is_released_and_retaken_a_submission_holds_one_or_none(
    counted: Entrant, steps: list[tuple[str, int]]
) -> None:
    """Against a plain count: who holds one, and since which day; an ended one holds what it held."""
    day, since, ended = 0, dict[str, int](), set[str]()
    with counted.platform.database.transaction() as session, pytest.MonkeyPatch.context() as patch:
        phase = another_phase(session, counted)
        rows = [a_submission(session, phase, counted) for _ in range(3)]
        ever = set[str]()
        for act, number in steps:
            row = rows[number]
            day += act == "wait" and 1 + 3 * number
            patch.setattr(scoring_quota, "now_ns", lambda day=day: NOW_NS + day * DAY_NS)
            if act == "reserve" and row not in ever:
                scoring_quota.reserve(session, phase, counted.team_id, row)
                since[row] = day
                ever.add(row)
            elif act == "release" and row not in ended:
                assert scoring_quota.release(session, row, "released: failed") == (row in since)
                since.pop(row, None)
            elif act == "retake" and row in ever:
                assert scoring_quota.retake(session, row) == (row not in since)
                since.setdefault(row, day)
            elif act == "consume" and row in since:
                scoring_quota.consume(session, row)
                ended.add(row)
            now = scoring_quota.scoring_quota(session, phase, counted.team_id, NOW_NS + day * DAY_NS + 1)
            assert now.used + now.reserved == sum(1 for taken in since.values() if day - taken < 7)
            assert scoring_quota.balance(session, phase.id, counted.team_id) == len(since)
