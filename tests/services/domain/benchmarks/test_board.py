"""The board: who stands on it, in which order, how surely, at which time; against what the counts say."""

from dataclasses import replace
from inspect import unwrap
from typing import Any

import numpy as np
import pytest

from services.domain.benchmarks.boards.board import MOST_ROWS, Board, LeaderboardRow, board, rank_confidence_of
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.boards.tables import notes
from services.domain.benchmarks.visibility import ANYBODY, Viewer
from services.runtime.orm import Reported
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.metric import RATIOS
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, HOUR_NS, Made, Scene, counts, scene

ALL = BoardQuery(entries="all")


def shown(at: Scene, query: BoardQuery = ALL, viewer: Viewer = ANYBODY) -> Board:
    return board(at.platform, at.phase_id, query, viewer)


def ranked(found: Board) -> list[LeaderboardRow]:
    return [row for row in found.rows if row.standing == "ranked"]


def ids(found: Board) -> list[str | None]:
    return [row.submission_id for row in ranked(found)]


def test_the_order_is_that_of_ratios_computed_from_the_counts(platform: Platform) -> None:
    at = scene(platform)
    errors = {at.enter(at.team(), Made(error, seed)): error for seed, error in enumerate((0.4, 0.2, 0.3))}
    found = shown(at)
    assert [errors[str(one)] for one in ids(found)] == [0.2, 0.3, 0.4]
    assert [row.rank for row in found.rows] == [1, 2, 3]
    for row, (seed, error) in zip(found.rows, ((1, 0.2), (2, 0.3), (0, 0.4)), strict=True):
        expected = ratios(counts(Made(error, seed)).sum(axis=(0, 1), dtype=np.int64))
        assert [row.ratios[name] for name in RATIOS] == pytest.approx(expected.tolist())


def test_entries_that_surely_differ_are_in_groups_of_their_own(platform: Platform) -> None:
    at = scene(platform)
    for error in (0.2, 0.3, 0.4):
        at.enter(at.team(), Made(error))
    found = shown(at)
    assert [(row.rank_interval, row.tie_group) for row in found.rows] == [((1, 1), 1), ((2, 2), 2), ((3, 3), 3)]
    assert found.rank_scope == "these_places"
    assert not any("whole sequences" in note for note in notes(found))


def test_a_board_states_that_whole_sequences_decided(platform: Platform) -> None:
    at = scene(platform)
    at.enter(at.team(), Made(0.2))
    assert any("whole sequences" in note for note in notes(replace(shown(at), rank_scope="new_place")))


def test_entries_that_hardly_differ_share_a_group_and_their_intervals_overlap(platform: Platform) -> None:
    at = scene(platform)
    for seed in (1, 2):
        at.enter(at.team(), Made(0.3, seed))
    at.enter(at.team(), Made(0.5, 3))
    assert [(row.rank_interval, row.tie_group) for row in shown(at).rows] == [((1, 2), 1), ((1, 2), 1), ((3, 3), 2)]


def test_equal_values_share_a_rank_and_the_earlier_stands_first(platform: Platform) -> None:
    at = scene(platform)
    later = at.enter(at.team(), Made(0.3), finalized_ns=2000)
    earlier = at.enter(at.team(), Made(0.3), finalized_ns=1000)
    last = at.enter(at.team(), Made(0.5))
    found = shown(at)
    assert ids(found) == [earlier, later, last]
    assert [row.rank for row in found.rows] == [1, 1, 3]
    assert [row.tie_group for row in found.rows] == [1, 1, 2]


@pytest.mark.parametrize("decides", ["iou_occ", "iou_n"])
def test_what_is_equal_in_miou_is_ordered_by_the_next_ratio(platform: Platform, decides: str) -> None:
    at = scene(platform)
    first, second = (at.enter(at.team(), Made(total=((decides, value),))) for value in (0.8, 0.9))
    assert ids(shown(at)) == [second, first]


def test_what_differs_less_than_is_shown_does_not_decide(platform: Platform) -> None:
    at = scene(platform)
    first = at.enter(at.team(), Made(total=(("miou", 0.51231), ("iou_occ", 0.7))))
    second = at.enter(at.team(), Made(total=(("miou", 0.51229), ("iou_occ", 0.8))))
    assert ids(shown(at)) == [second, first]


def test_an_undefined_entry_is_listed_without_a_rank_and_never_first(platform: Platform) -> None:
    at = scene(platform)
    undefined = at.enter(at.team(), Made(0.0, without=3))
    defined = at.enter(at.team(), Made(0.9))
    found = shown(at)
    assert ids(found) == [defined]
    last = found.rows[-1]
    assert (last.submission_id, last.standing, last.rank, last.tie_group) == (undefined, "undefined", None, None)
    assert (last.ratios["iou_n"], last.ratios["miou"]) == (None, None)
    assert last.support["N"] == 0


def test_a_baseline_is_shown_but_has_no_rank(platform: Platform) -> None:
    at = scene(platform)
    at.enter(at.team(), Made(0.1), kind="baseline")
    at.enter(at.team(), Made(0.3))
    found = shown(at)
    assert [(row.standing, row.rank) for row in found.rows] == [("ranked", 1), ("baseline", None)]
    assert found.ranked_total == 1


def test_reported_results_stand_last_with_their_source(platform: Platform) -> None:
    at = scene(platform)
    at.enter(at.team(), Made(0.3))
    with platform.database.transaction() as session:
        for method, miou in (("Old", 0.1), ("Unknown", None), ("New", 0.2)):
            noted = {"note": "of another split", "percent_digits": 1} if method == "New" else {}
            row = Reported(phase_id=at.phase_id, method=method, modality="C", source="a paper", miou=miou, **noted)
            session.add(row)
    found = shown(at)
    assert [row.method for row in found.rows[1:]] == ["New", "Old", "Unknown"]
    assert {row.standing for row in found.rows[1:]} == {"reported"}
    assert {(row.rank, row.source, row.submission_id) for row in found.rows[1:]} == {(None, "a paper", None)}
    assert [(row.note, row.percent_digits) for row in found.rows] == [
        (None, 2),
        ("of another split", 1),
        (None, 2),
        (None, 2),
    ]
    assert shown(at, BoardQuery("L", None, "all")).rows == found.rows[:1]


def test_a_ceiling_is_above_the_ranks_on_every_track_and_takes_none(platform: Platform) -> None:
    at = scene(platform)
    at.enter(at.team(), Made(0.3), modality="C")
    tracks = [BoardQuery(track, None, "all") for track in ("all", "C", "R")]  # type: ignore[arg-type]
    before = [shown(at, query) for query in tracks]
    assert not any("ceiling" in note for found in before for note in notes(found))
    with platform.database.transaction() as session:
        for kind, miou in (("ceiling", 0.1), ("published", 0.9)):
            row = {"method": kind, "modality": "L", "source": "s", "kind": kind, "miou": miou}
            session.add(Reported(phase_id=at.phase_id, **row))
    after = [shown(at, query) for query in tracks]
    told = [[(row.standing, row.rank) for row in found.rows] for found in after]
    assert told == [[("ceiling", None), ("ranked", 1), ("reported", None)], [("ceiling", None), ("ranked", 1)],
                    [("ceiling", None)]]  # fmt: skip
    assert [found.ranked_total for found in after] == [found.ranked_total for found in before]
    assert all(any("no entry can be expected to score above it" in note for note in notes(found)) for found in after)


@pytest.mark.parametrize("made", [Made(0.3), Made(0.3, is_withdrawn=True)])
def test_danger_is_counted_from_the_confusion_also_of_earlier_scores(platform: Platform, made: Made) -> None:
    at = scene(platform)
    at.enter(at.team(), made)
    of_n = counts(made).sum(axis=(0, 1), dtype=np.int64)[3]
    (row,) = shown(at).rows
    assert row.danger == {
        "n_predicted_drivable_ratio": (of_n[1] + of_n[2]) / of_n.sum(),
        "n_predicted_t_ratio": of_n[1] / of_n.sum(),
    }
    at.hide()
    assert [shown(at, viewer=viewer).rows[0].danger is None for viewer in (ANYBODY, ADMINISTRATOR)] == [True, False]


def test_only_scored_entries_that_stand_are_on_the_board(platform: Platform) -> None:
    at = scene(platform)
    one = at.enter(at.team(), Made(0.3))
    states = ("draft", "queued", "scoring", "valid", "invalid", "failed", "cancelled")
    gone: tuple[dict[str, Any], ...] = (
        {"withdrawn_ns": 1},
        {"hidden_ns": 1},
        {"kind": "validation"},
        *({"state": state} for state in states),
    )
    standing = {"withdrawn_ns": None, "hidden_ns": None, "kind": "entry", "state": "scored"}
    for columns in gone:
        at.change(one, **{**standing, **columns})
        assert shown(at, viewer=ADMINISTRATOR).rows == (), columns
        at.change(one, **standing)
        assert ids(shown(at)) == [one]


def test_best_is_one_entry_of_each_team_and_all_is_all(platform: Platform) -> None:
    at = scene(platform)
    one, other = at.team(), at.team()
    worse, best, second = (at.enter(team, Made(e)) for team, e in ((one, 0.4), (one, 0.2), (other, 0.3)))
    at.enter(one, Made(0.0, without=3))
    assert ids(shown(at, BoardQuery())) == [best, second]
    assert [row.standing for row in shown(at, BoardQuery()).rows] == ["ranked", "ranked"]
    assert ids(shown(at)) == [best, second, worse]


def test_a_team_with_nothing_defined_is_listed_once_among_the_best(platform: Platform) -> None:
    at = scene(platform)
    team = at.team()
    for error in (0.1, 0.2):
        at.enter(team, Made(error, without=1))
    assert [row.standing for row in shown(at, BoardQuery()).rows] == ["undefined"]


def test_a_track_is_of_the_entries_that_declared_it(platform: Platform) -> None:
    at = scene(platform)
    camera = at.enter(at.team(), Made(0.3), modality="C")
    both = at.enter(at.team(), Made(0.2), modality="C+L")
    assert ids(shown(at, BoardQuery("C"))) == [camera]
    assert ids(shown(at, BoardQuery("C+L"))) == [both]
    assert ids(shown(at, BoardQuery("R"))) == []
    assert shown(at, BoardQuery("C")).rows[0].rank == 1


def test_a_board_of_the_past_is_that_of_the_past(platform: Platform) -> None:
    at, now = scene(platform), now_ns()
    early = at.enter(at.team(), Made(0.4), settled_ns=now - 50 * HOUR_NS)
    gone = at.enter(at.team(), Made(0.3), settled_ns=now - 50 * HOUR_NS, withdrawn_ns=now - 20 * HOUR_NS)
    hidden = at.enter(at.team(), Made(0.2), settled_ns=now - 50 * HOUR_NS, hidden_ns=now - 30 * HOUR_NS)
    late = at.enter(at.team(), Made(0.1), settled_ns=now - 10 * HOUR_NS)

    def then(hours: int) -> list[str | None]:
        return ids(shown(at, BoardQuery(as_of_ns=now - hours * HOUR_NS)))

    assert then(60) == []
    assert then(40) == [hidden, gone, early]
    assert then(25) == [gone, early]
    assert then(15) == [early]
    assert then(5) == ids(shown(at)) == [late, early]


def test_a_board_shows_one_pair_and_the_old_one_for_the_past(platform: Platform) -> None:
    at, now = scene(platform), now_ns()
    entered = at.enter(at.team(), Made(0.4), settled_ns=now - 50 * HOUR_NS)
    new = at.another_pair(activated_ns=now - 10 * HOUR_NS)
    at.score(entered, Made(0.2), new)
    unscored = at.enter(at.team(), Made(0.1), settled_ns=now - 50 * HOUR_NS)
    today, before = shown(at), shown(at, BoardQuery(as_of_ns=now - 20 * HOUR_NS, entries="all"))
    assert (today.pair.truth_number, before.pair.truth_number) == (2, 1)
    assert (ids(today), ids(before)) == ([entered], [unscored, entered])
    assert (today.rows[0].ratios["miou"] or 0) > (before.rows[1].ratios["miou"] or 0)


def test_before_the_first_ground_truth_there_is_an_empty_board(platform: Platform) -> None:
    at = scene(platform)
    at.enter(at.team(), Made())
    found = shown(at, BoardQuery(as_of_ns=1))
    assert (found.pair, found.rows, found.ranked_total) == (None, (), 0)


def test_a_board_of_one_claims_nothing(platform: Platform) -> None:
    at = scene(platform)
    at.enter(at.team(), Made(0.2))
    found = shown(at)
    assert [(row.rank, row.rank_interval, row.tie_group) for row in found.rows] == [(1, None, None)]
    assert found.silence is None


def test_scores_of_a_metric_whose_intervals_are_withdrawn_claim_nothing(platform: Platform) -> None:
    """Bootstrap replicates were kept of them, and intervals that claimed more than was known."""
    at = scene(platform)
    entered = [at.enter(at.team(), Made(error, is_withdrawn=True)) for error in (0.2, 0.4)]
    found = shown(at)
    assert ids(found) == entered
    assert found.silence == "withdrawn"
    for row in found.rows:
        assert (row.rank_interval, row.tie_group, row.intervals) == (None, None, None)
    assert any("withdrawn" in note for note in notes(found))


def test_entries_below_those_that_are_compared_claim_nothing(
    platform: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = scene(platform)
    for error in (0.2, 0.3, 0.4):
        at.enter(at.team(), Made(error))
    monkeypatch.setattr("services.domain.benchmarks.boards.board.MOST_COMPARED", 2)
    monkeypatch.setattr(
        "services.domain.benchmarks.boards.board.rank_confidence_of", unwrap(rank_confidence_of)
    )  # nothing is remembered
    assert [(row.rank_interval, row.tie_group) for row in shown(at).rows] == [((1, 2), 1), ((2, 3), 2), (None, None)]


def test_a_board_shows_at_most_so_many(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    at = scene(platform)
    for error in (0.1, 0.2, 0.3):
        at.enter(at.team(), Made(error))
    assert MOST_ROWS > 600
    monkeypatch.setattr("services.domain.benchmarks.boards.board.MOST_ROWS", 2)
    found = shown(at)
    assert ([row.rank for row in found.rows], found.ranked_total) == ([1, 2], 3)
