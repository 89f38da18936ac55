"""Alarms: equal and near-equal predictions are found whatever the order, told once, and honest work raises none."""

from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import select

from services.domain.benchmarks.alarms.alarms import dismiss, open_alarms, raise_alarms
from services.domain.benchmarks.alarms.similarity import DAY_NS, AlarmLimits, differing_ratio
from services.domain.benchmarks.rescores.errors import AlarmDismissedError, AlarmMissingError
from services.runtime.orm import Alarm, Phase
from services.runtime.platform import Platform
from stone.scoring.metric import OCCUPIED_VERSION
from tests.services.domain.benchmarks.scored import CELLS, Laid, Place, another_truth, entry, phase_of_rows, score, team

NOON_NS = 20_000 * DAY_NS + DAY_NS // 2


def _cells(moved: int) -> dict[str, Any]:
    """The counts of a submission that predicts this many voxels of the truth's free space otherwise."""
    cells = np.array(CELLS) * 100
    cells[0, 0, 0] -= moved
    cells[0, 0, 1] += moved
    return {"forest": cells.tolist()}


def _join(place: Place, submission_id: str, moved: int, **columns: Any) -> None:
    with place.platform.database.transaction() as session:
        laid = Laid(cells=_cells(moved), columns=columns)
        raise_alarms(session, score(session, place, submission_id, laid))


def _raised(place: Place) -> list[tuple[str, str]]:
    with place.platform.database.reading() as session:
        return sorted((alarm.kind, alarm.subject) for alarm in session.scalars(open_alarms(place.phase.id)))


def test_equal_predictions_of_two_teams_are_told_about_the_later_one(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours, theirs = team(place, "Ours"), team(place, "Theirs")
    first, second = entry(place, ours), entry(place, theirs)
    _join(place, first, 0)
    assert _raised(place) == []
    _join(place, second, 0)
    assert _raised(place) == [("equal_content", second)]
    with platform.database.reading() as session:
        facts = session.scalars(select(Alarm)).one().facts
    assert (facts["submission_id"], facts["team"]) == (second, "Theirs")
    assert [(one["submission_id"], one["team"]) for one in facts["others"]] == [(first, "Ours")]


def test_whatever_the_order_of_the_joins_the_same_is_told(platform: Platform) -> None:
    for order in permutations(range(3)):
        place = phase_of_rows(platform)
        ids = [entry(place, team(place)) for _ in range(3)]
        for index in order:
            _join(place, ids[index], (0, 0, 1)[index])
        assert _raised(place) == [("equal_content", ids[1]), ("near_equal_teams", ids[2])]


def test_a_re_score_tells_nothing_twice(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ids = [entry(place, team(place)) for _ in range(2)]
    for submission_id in ids:
        _join(place, submission_id, 0)
    truth_id = another_truth(place)
    for submission_id in reversed(ids):
        _join(place, submission_id, 5, truth_id=truth_id)
        _join(place, submission_id, 5, truth_id=truth_id, metric=OCCUPIED_VERSION)
    assert _raised(place) == [("equal_content", ids[1])]


def test_one_team_may_send_the_same_twice_and_baselines_may_be_sent_by_anybody(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    for team_id, columns in ((ours, {"kind": "baseline"}), (ours, {}), (ours, {})):
        _join(place, entry(place, team_id, **columns), 0)
    _join(place, entry(place, team(place), kind="baseline"), 0)
    assert _raised(place) == []


def test_where_the_truth_is_hidden_baselines_that_probe_it_or_are_copied_are_told(platform: Platform) -> None:
    """The attack: a curator sends baseline after baseline, each a voxel off the last, and reads the board."""
    place = phase_of_rows(platform)
    with platform.database.transaction() as session:
        session.get_one(Phase, place.phase.id).is_hidden = True
    ours = team(place)
    for number in range(5):
        _join(place, entry(place, ours, kind="baseline", finalized_ns=NOON_NS + number), number)
    probing = [("near_equal", f"{ours}:{NOON_NS // DAY_NS}")]
    assert _raised(place) == probing
    copied = entry(place, team(place), finalized_ns=NOON_NS + 9)
    _join(place, copied, 0)
    assert _raised(place) == sorted([*probing, ("equal_content", copied), ("near_equal_teams", copied)])


def test_entries_of_another_ground_truth_are_not_compared(platform: Platform) -> None:
    place = phase_of_rows(platform)
    _join(place, entry(place, team(place)), 0)
    _join(place, entry(place, team(place)), 0, truth_id=another_truth(place))
    assert _raised(place) == []


def test_five_near_equal_entries_of_a_day_are_probing_and_four_are_not(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    for number in range(4):
        _join(place, entry(place, ours, finalized_ns=NOON_NS + number), number)
    assert _raised(place) == []
    _join(place, entry(place, ours, finalized_ns=NOON_NS + 4), 4)
    _join(place, entry(place, ours, finalized_ns=NOON_NS + 5), 5)
    assert _raised(place) == [("near_equal", f"{ours}:{NOON_NS // DAY_NS}")]
    with platform.database.reading() as session:
        assert len(session.scalars(select(Alarm)).one().facts["entries"]) == 5


def test_probing_is_found_whichever_is_scored_last(platform: Platform) -> None:
    for late in range(5):
        place = phase_of_rows(platform)
        ours = team(place)
        ids = [entry(place, ours, finalized_ns=NOON_NS + number) for number in range(5)]
        for number in [one for one in range(5) if one != late] + [late]:
            _join(place, ids[number], number)
        assert _raised(place) == [("near_equal", f"{ours}:{NOON_NS // DAY_NS}")]


def test_near_entries_of_five_days_and_far_ones_of_one_day_are_no_probing(platform: Platform) -> None:
    place = phase_of_rows(platform)
    slow, varied = team(place), team(place)
    for number in range(6):
        _join(place, entry(place, slow, finalized_ns=NOON_NS + number * DAY_NS), number)
        _join(place, entry(place, varied, finalized_ns=NOON_NS + number), 10_000 + 5000 * number)
    assert _raised(place) == []


def test_only_so_many_are_looked_at(platform: Platform) -> None:
    place = phase_of_rows(platform)
    limits = AlarmLimits(near_entries=3, looked_at=2)
    ours = team(place)
    for number in range(4):
        submission_id = entry(place, ours, finalized_ns=NOON_NS + number)
        with platform.database.transaction() as session:
            raise_alarms(session, score(session, place, submission_id, Laid(cells=_cells(number))), limits)
    assert _raised(place) == []


def test_a_dismissed_alarm_is_not_raised_again(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ids = [entry(place, team(place)) for _ in range(2)]
    for submission_id in ids:
        _join(place, submission_id, 0)
    with platform.database.transaction() as session:
        alarm_id = dismiss(session, session.scalars(select(Alarm.id)).one()).id
    _join(place, ids[1], 0, truth_id=another_truth(place))
    assert _raised(place) == []
    with pytest.raises(AlarmDismissedError), platform.database.transaction() as session:
        dismiss(session, alarm_id)
    with pytest.raises(AlarmMissingError), platform.database.transaction() as session:
        dismiss(session, "0" * 32)


@given(st.data())
def test_no_two_predictions_differ_by_less_than_is_told(data: st.DataObject) -> None:
    shape = (data.draw(st.integers(1, 60)),)
    grids = [np.array(data.draw(st.lists(st.integers(0, 3), min_size=shape[0], max_size=shape[0]))) for _ in range(3)]
    truth, one, other = grids
    counts = [np.bincount(truth * 4 + grid, minlength=16) for grid in (one, other)]
    told = differing_ratio(counts[0], counts[1][None])[0]
    assert 0 <= told <= np.mean(one != other) + 1e-12


def test_what_has_no_voxels_is_near_to_nothing() -> None:
    assert differing_ratio(np.zeros(4, np.int64), np.zeros((2, 4), np.int64)).tolist() == [1.0, 1.0]
