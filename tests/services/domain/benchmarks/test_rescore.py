"""Re-scores begin once, cover what stands and switch the board as a whole; alarms tell of equal and probing entries."""

from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy import select

from services.domain.benchmarks.alarms.alarms import (
    DAY_NS,
    AlarmLimits,
    differing_ratio,
    dismiss,
    open_alarms,
    raise_alarms,
)
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, active, in_force, versions_to_score
from services.domain.benchmarks.rescores.diff import RescoreDiff, RescoreMove, RescoreSide
from services.domain.benchmarks.rescores.errors import AlarmDismissedError, RescoreStateError
from services.domain.benchmarks.rescores.progress import RescoreProgress, rescore_progress
from services.domain.benchmarks.rescores.rescore import NewRescore, abandon, activate, old_version, start_rescore
from services.runtime.jobs.claims import claim
from services.runtime.jobs.completion import Failure, fail
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Activation, Alarm, GroundTruthRow, Job, Phase, Rescore
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION, OCCUPIED_VERSION
from testing.refusals import refused_as
from tests.services.domain.benchmarks.scored import (
    CELLS,
    Laid,
    Place,
    another_truth,
    entry,
    phase_of_rows,
    score,
    scored,
    scored_entry,
    team,
)


@dataclass(frozen=True)
class Started:
    rescore_id: str
    job_id: str | None


def _start(place: Place, pair: EvaluationVersion) -> Started:
    with place.platform.database.transaction() as session:
        rescore, run = start_rescore(session, place.phase, NewRescore(pair, place.user.id, "labels corrected"))
        return Started(rescore.id, run.id if run else None)


def _submissions_of(place: Place, job_id: str | None) -> list[str]:
    """The submissions that the run's joins score, in the order in which they are taken."""
    with place.platform.database.reading() as session:
        joins = select(Job.arguments).where(Job.root_id == job_id, Job.kind == "eval.join").order_by(Job.id)
        return [arguments["submission_id"] for arguments in session.scalars(joins) if arguments]


def _progress(place: Place, rescore_id: str) -> RescoreProgress:
    with place.platform.database.reading() as session:
        return rescore_progress(session, session.get_one(Rescore, rescore_id))


def _activate(place: Place, rescore_id: str, expected: str | None = "") -> str:
    with place.platform.database.transaction() as session:
        shown = in_force(session, place.phase.id)
        expected = (shown.id if shown else None) if expected == "" else expected
        return activate(session, session.get_one(Rescore, rescore_id), expected, place.user.id).id


def test_a_bulk_run_covers_entries_and_baselines_that_stand_and_nothing_else(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    standing = [scored_entry(place, ours), scored_entry(place, ours, kind="baseline")]
    hidden = scored_entry(place, ours, hidden_ns=1)
    for columns in ({"state": "invalid"}, {"state": "queued"}, {"withdrawn_ns": 1}, {"kind": "validation"}):
        entry(place, ours, **columns)
    purged = scored_entry(place, ours, blob_sha256=None)
    pair = EvaluationVersion(another_truth(place), METRIC_VERSION)
    started = _start(place, pair)
    assert _submissions_of(place, started.job_id) == [*standing, hidden]
    assert purged not in _submissions_of(place, started.job_id)
    assert _progress(place, started.rescore_id) == RescoreProgress(total=4, scored=0, missing=2, hidden=1, gone=1)


def test_another_metric_needs_no_file(platform: Platform) -> None:
    place = phase_of_rows(platform)
    purged = scored_entry(place, team(place), blob_sha256=None)
    started = _start(place, EvaluationVersion(place.truth_id, OCCUPIED_VERSION))
    assert _submissions_of(place, started.job_id) == [purged]
    assert _progress(place, started.rescore_id).gone == 0


def test_a_new_submission_goes_before_a_re_score(platform: Platform) -> None:
    place = phase_of_rows(platform)
    scored_entry(place, team(place))
    _start(place, EvaluationVersion(another_truth(place), METRIC_VERSION))
    with platform.database.transaction() as session:
        fresh = enqueue(session, JobSpec("eval.open", {"submission_id": "new"}), Context(place.user.id)).id
    with platform.database.transaction() as session:
        taken = claim(session, "eval")
    assert taken.job_id == fresh


def test_started_again_after_its_run_failed_it_does_what_is_missing_and_what_failed_last(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    done, poisoned, rest = (scored_entry(place, ours) for _ in range(3))
    pair = EvaluationVersion(another_truth(place), METRIC_VERSION)
    first = _start(place, pair)
    scored(place, done, 0.4, pair.truth_id)
    _fail_for(place, first.job_id, poisoned)
    again = _start(place, pair)
    assert again.rescore_id == first.rescore_id
    assert again.job_id != first.job_id
    assert _submissions_of(place, again.job_id) == [rest, poisoned]


def _fail_for(place: Place, run_id: str | None, submission_id: str) -> None:
    """Let the first job of the run for this submission fail, as a worker does."""
    with place.platform.database.transaction() as session:
        for job in session.scalars(select(Job).where(Job.root_id == run_id, Job.id != run_id)):
            job.priority = 1 if (job.arguments or {}).get("submission_id") == submission_id else job.priority
    with place.platform.database.transaction() as session:
        taken = claim(session, "eval")
        assert taken.arguments["submission_id"] == submission_id
        assert fail(session, taken, Failure("internal_error", "it broke"))


def test_nothing_missing_needs_no_run_and_is_complete(platform: Platform) -> None:
    place = phase_of_rows(platform)
    one = scored_entry(place, team(place))
    pair = EvaluationVersion(another_truth(place), METRIC_VERSION)
    scored(place, one, 0.4, pair.truth_id)
    started = _start(place, pair)
    assert started.job_id is None
    assert _progress(place, started.rescore_id).is_complete


def test_what_cannot_be_re_scored_is_refused(platform: Platform) -> None:
    place, other = phase_of_rows(platform), phase_of_rows(platform)
    scored_entry(place, team(place))
    for pair, error in (
        (EvaluationVersion(place.truth_id, METRIC_VERSION), "already_active"),
        (EvaluationVersion(place.truth_id, "stone-iou-0"), "unknown_metric"),
        (EvaluationVersion(place.truth_id, "stone-iou-1"), "superseded_metric"),
        (EvaluationVersion(other.truth_id, METRIC_VERSION), "ground_truth_of_other_phase"),
        (EvaluationVersion("0" * 32, METRIC_VERSION), "ground_truth_of_other_phase"),
        (EvaluationVersion(another_truth(place, is_ready=False), METRIC_VERSION), "truth_not_ready"),
    ):
        with refused_as(error):
            _start(place, pair)
    with platform.database.reading() as session:
        assert not session.scalars(select(Rescore)).all()


def test_an_entry_that_was_hidden_during_a_re_score_catches_up_by_the_pair_of_the_board(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    shown, hidden = scored_entry(place, ours), scored_entry(place, ours, hidden_ns=1)
    pair = EvaluationVersion(another_truth(place), METRIC_VERSION)
    started = _start(place, pair)
    scored(place, shown, 0.4, pair.truth_id)
    _activate(place, started.rescore_id)
    assert _submissions_of(place, _start(place, pair).job_id) == [hidden]


def test_the_board_switches_as_a_whole_and_the_old_pair_stays_readable(platform: Platform) -> None:
    place = phase_of_rows(platform)
    one = scored_entry(place, team(place))
    old, new = (
        EvaluationVersion(place.truth_id, METRIC_VERSION),
        EvaluationVersion(another_truth(place), METRIC_VERSION),
    )
    started = _start(place, new)
    before_ns = now_ns()
    with platform.database.reading() as session:
        assert active(session, place.phase.id) == old
        assert versions_to_score(session, place.phase.id) == (old, new)
    with refused_as("rescore_incomplete", match="1 entries"):
        _activate(place, started.rescore_id)
    scored(place, one, 0.4, new.truth_id)
    _activate(place, started.rescore_id)
    with platform.database.reading() as session:
        assert active(session, place.phase.id) == new
        assert active(session, place.phase.id, before_ns) == old
        assert versions_to_score(session, place.phase.id) == (new,)
        assert old_version(session, session.get_one(Rescore, started.rescore_id)) == old


def test_a_switch_from_a_board_that_moved_is_refused(platform: Platform) -> None:
    place = phase_of_rows(platform)
    with platform.database.reading() as session:
        shown = in_force(session, place.phase.id)
    first = _start(place, EvaluationVersion(another_truth(place), METRIC_VERSION))
    second = _start(place, EvaluationVersion(another_truth(place), METRIC_VERSION))
    moved = _activate(place, first.rescore_id, shown.id)
    with refused_as("leaderboard_changed", match=moved):
        _activate(place, second.rescore_id, shown.id)
    assert _activate(place, second.rescore_id, moved)


def test_a_switch_to_a_ground_truth_that_is_not_ready_any_more_is_refused(platform: Platform) -> None:
    place = phase_of_rows(platform)
    truth_id = another_truth(place)
    started = _start(place, EvaluationVersion(truth_id, METRIC_VERSION))
    with platform.database.transaction() as session:
        session.get_one(GroundTruthRow, truth_id).ready_ns = None
    with refused_as("truth_not_ready"):
        _activate(place, started.rescore_id)


def test_a_clock_set_back_does_not_bring_the_old_board_back(platform: Platform) -> None:
    place = phase_of_rows(platform)
    with platform.database.transaction() as session:
        ahead = Activation(phase_id=place.phase.id, truth_id=place.truth_id, metric=OCCUPIED_VERSION)
        ahead.activated_by, ahead.activated_ns = place.user.id, now_ns() + 10**12
        session.add(ahead)
    new = EvaluationVersion(another_truth(place), METRIC_VERSION)
    _activate(place, _start(place, new).rescore_id)
    with platform.database.reading() as session:
        assert active(session, place.phase.id) == new


def test_abandoned_its_run_stops_its_pair_is_pending_no_more_and_scores_stay(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    done = scored_entry(place, ours)
    scored_entry(place, ours)
    pair = EvaluationVersion(another_truth(place), METRIC_VERSION)
    started = _start(place, pair)
    scored(place, done, 0.4, pair.truth_id)
    with platform.database.transaction() as session:
        abandon(session, session.get_one(Rescore, started.rescore_id), "a mistake")
    with platform.database.reading() as session:
        assert session.get_one(Job, started.job_id).state == "cancelled"
        assert versions_to_score(session, place.phase.id) == (EvaluationVersion(place.truth_id, METRIC_VERSION),)
    assert _progress(place, started.rescore_id).scored == 1
    for act in (lambda: _activate(place, started.rescore_id), lambda: _abandon(place, started.rescore_id)):
        with pytest.raises(RescoreStateError):
            act()


def _abandon(place: Place, rescore_id: str) -> None:
    with place.platform.database.transaction() as session:
        abandon(session, session.get_one(Rescore, rescore_id), "again")


def test_every_part_of_every_entry_is_a_job_of_the_one_run(platform: Platform) -> None:
    place = phase_of_rows(platform)
    ours = team(place)
    ids = [scored_entry(place, ours) for _ in range(5)]
    started = _start(place, EvaluationVersion(another_truth(place), METRIC_VERSION))
    assert _submissions_of(place, started.job_id) == ids
    with platform.database.reading() as session:
        kinds = session.scalars(select(Job.kind).where(Job.root_id == started.job_id, Job.queue == "eval")).all()
    assert sorted(kinds) == ["eval.join"] * 5 + ["eval.part"] * 5 * 4


def diff_of(*ranks: tuple[int | None, int | None]) -> RescoreDiff:
    """A difference of entries, numbered from 0, with these ranks before and after."""
    rows = [
        RescoreMove(str(number), "team", "method", "lidar", "entry", None, None, *both)
        for number, both in enumerate(ranks)
    ]
    return RescoreDiff(None, RescoreSide("truth", 1, "stone-iou-2"), tuple(rows))


@pytest.mark.parametrize(
    ("ranks", "is_order_changed", "is_new_leader"),
    [
        ([(1, 1), (2, 2), (None, None)], False, False),
        ([(1, 1), (2, 3), (3, 2)], True, False),
        ([(1, 2), (2, 1)], True, True),
        ([(1, 1), (2, None)], True, False),
        ([(1, 1), (None, 2)], True, False),
        ([(1, 1), (1, 1)], False, False),
    ],
)
def test_an_order_is_another_where_any_entry_has_another_rank_or_stands_on_one_board_only(
    ranks: list[tuple[int | None, int | None]], is_order_changed: bool, is_new_leader: bool
) -> None:
    found = diff_of(*ranks)
    assert (found.is_order_changed, found.is_new_leader) == (is_order_changed, is_new_leader)


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


LATE = {
    "ratios": {"iou_occ": 0.9, "miou": 0.8},
    "elsewhere": {"iou_occ": 0.92, "miou": 0.9},
    "support": {"free": 90_000, "T": 100, "P": 2000, "N": 4000},
}


@pytest.mark.parametrize(
    ("changed", "is_raised"),
    [
        ({}, True),
        ({"ratios": {"iou_occ": 0.9, "miou": 0.6}}, False),
        ({"ratios": {"iou_occ": 0.6, "miou": 0.8}}, False),
        ({"ratios": {"iou_occ": 0.9, "miou": None}}, True),
        ({"ratios": {"iou_occ": 0.03, "miou": 0.01}, "elsewhere": {"iou_occ": 0.03, "miou": 0.01}}, False),
        ({"support": {"free": 90_000, "T": 0, "P": 1000, "N": 3999}}, False),
    ],
)
def test_an_entry_as_good_where_only_later_sweeps_looked_is_told(platform: Platform, changed, is_raised) -> None:
    place = phase_of_rows(platform)
    record = {"cells": _cells(0), "late": {**LATE, **changed}}
    for is_hidden in (False, True):
        with platform.database.transaction() as session:
            session.get_one(Phase, place.phase.id).is_hidden = is_hidden
        sent = entry(place, team(place))
        _join(place, sent, 1000 * is_hidden, record=record | {"cells": _cells(1000 * is_hidden)})
        assert _raised(place) == ([("late_as_good", sent)] if is_hidden and is_raised else [])


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
    with refused_as("alarm_missing"), platform.database.transaction() as session:
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
