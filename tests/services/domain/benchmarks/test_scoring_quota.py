"""The ledger of scorings: what is taken is given back once, and nobody takes the last one twice."""

from collections.abc import Iterable

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.errors import ExhaustedError
from services.runtime.orm import Phase, ScoringEntry
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.refusals import refused_as
from tests.services.domain.benchmarks.drafts import (
    Entrant,
    a_submission,
    another_entrant,
    another_phase,
    drafted,
    entrant_on,
    reserved,
    standing,
)
from tests.services.runtime.jobs.steps import act

DAY_NS = 86_400 * 10**9
NOW_NS = 1_800_000_000 * 10**9


def granted(entrant: Entrant, amount: int) -> None:
    with entrant.platform.database.transaction() as session:
        scoring_quota.grant(session, session.get_one(Phase, entrant.phase_id), entrant.team_id, amount, "a broken week")


def wait(monkeypatch: pytest.MonkeyPatch, passed_ns: int) -> None:
    """From now on it is this much later."""
    monkeypatch.setattr(scoring_quota, "now_ns", lambda: now_ns() + passed_ns)


def test_the_window_rolls_and_says_when_it_is_open_again(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=1)
    reserved(entrant)
    with pytest.raises(ExhaustedError) as refused:
        reserved(entrant)
    next_ns = refused.value.next_ns
    assert refused.value.code == "scorings_exhausted"
    assert next_ns is not None
    assert standing(entrant).next_slot_ns == next_ns
    assert standing(entrant, next_ns - 1).next_slot_ns == next_ns
    assert standing(entrant, next_ns).next_slot_ns == next_ns
    assert standing(entrant, next_ns).reserved == 0
    wait(monkeypatch, 7 * DAY_NS)
    reserved(entrant)


def test_a_total_that_is_used_up_has_no_next_time_until_more_are_granted(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    entrant = entrant_on(platform_on, scorings_total=1)
    reserved(entrant)
    wait(monkeypatch, 300 * DAY_NS)
    assert (standing(entrant).total_left, standing(entrant).next_slot_ns) == (0, None)
    with refused_as("scorings_exhausted"):
        reserved(entrant)
    granted(entrant, 2)
    assert standing(entrant).total_left == 2
    reserved(entrant)
    assert standing(entrant).total_left == 1


def test_a_grant_opens_the_window_too_and_is_taken_back_the_same_way(platform_on: Platform) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=1)
    reserved(entrant)
    granted(entrant, 1)
    assert standing(entrant).limit == 2
    granted(entrant, -1)
    assert standing(entrant).limit == 1
    with refused_as("scorings_exhausted"):
        reserved(entrant)


def test_teams_do_not_share_what_they_have(platform_on: Platform) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=1, scorings_total=1)
    other = another_entrant(entrant.place)
    reserved(entrant)
    granted(entrant, -5)
    assert (standing(other).reserved, standing(other).total_left, standing(other).limit) == (0, 1, 1)
    reserved(other)


def test_what_is_tried_again_is_taken_again_beyond_any_limit(platform_on: Platform) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=1)
    first = reserved(entrant)
    act(platform_on, scoring_quota.release, first, "released: failed")
    reserved(entrant)
    for taken in (1, 0):
        assert act(platform_on, scoring_quota.retake, first) == taken
    assert standing(entrant).reserved == 2


def test_what_never_held_a_scoring_takes_and_gives_none(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant, kind="validation")
    with platform.database.transaction() as session:
        scoring_quota.consume(session, submission_id)
        assert scoring_quota.release(session, submission_id, "released: valid") == 0
        assert scoring_quota.retake(session, submission_id) == 0
        assert session.query(ScoringEntry).count() == 0


ENTRIES = st.lists(
    st.tuples(st.integers(0, 20), st.sampled_from(["reserved", "consumed", "released", "granted"]), st.integers(-2, 3)),
    max_size=12,
)


def has_room(entries: Iterable[tuple[int, str, int]], limits: tuple[int | None, int | None], at_day: int) -> bool:
    """Counted one by one: whether one more may be reserved at this day, 7 days after which a scoring is forgotten."""
    per_window, total = limits
    entries = list(entries)
    held = [day for day, kind, _ in entries if kind in ("reserved", "consumed")]
    gifts = [(day, amount) for day, kind, amount in entries if kind == "granted"]
    in_window = sum(1 for day in held if at_day - day < 7) - sum(amount for day, amount in gifts if at_day - day < 7)
    in_all = len(held) - sum(amount for _, amount in gifts)
    return (per_window is None or in_window < per_window) and (total is None or in_all < total)


@pytest.fixture
def counted(platform: Platform) -> Entrant:
    return entrant_on(platform)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(entries=ENTRIES, per_window=st.none() | st.integers(0, 3), total=st.none() | st.integers(0, 6))
def test_the_next_time_is_the_first_at_which_there_is_room(
    counted: Entrant, entries: list[tuple[int, str, int]], per_window: int | None, total: int | None
) -> None:
    """Against a count of every day by itself; what is released leaves no trace."""
    with counted.platform.database.transaction() as session:
        phase = another_phase(session, counted, per_window, total)
        for entry in entries:
            _write(session, phase, counted, entry)
        session.flush()
        found = scoring_quota.scoring_quota(session, phase, counted.team_id, NOW_NS + 20 * DAY_NS).next_slot_ns
    days = range(20, 60)
    expected = next((day for day in days if has_room(entries, (per_window, total), day)), None)
    assert found == (None if expected is None else NOW_NS + expected * DAY_NS)


def _write(session: Session, phase: Phase, entrant: Entrant, entry: tuple[int, str, int]) -> None:
    """One of the entries as the ledger holds it: a reservation is followed by its end."""
    day, kind, amount = entry
    steps = [(0, -amount, "granted")] if kind == "granted" else [(0, 1, "reserved")]
    steps += {"consumed": [(1, 0, "consumed")], "released": [(1, -1, "released: failed")]}.get(kind, [])
    submission_id = None
    if kind != "granted":
        submission_id = a_submission(session, phase, entrant)
    for later_ns, step, reason in steps:
        at_ns = NOW_NS + day * DAY_NS + later_ns
        line = ScoringEntry(phase_id=phase.id, team_id=entrant.team_id, submission_id=submission_id, created_ns=at_ns)
        line.amount, line.reason = step, reason
        session.add(line)


STEPS = st.lists(
    st.tuples(st.sampled_from(["reserve", "release", "retake", "consume", "wait"]), st.integers(0, 2)), max_size=14
)


@pytest.mark.whole
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
