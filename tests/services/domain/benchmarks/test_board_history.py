"""When a board changed, held against the board itself as of those moments."""

import pytest

from services.domain.benchmarks.boards.board import board
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.boards.history import DAY_NS, MOST_CHANGES, BoardChange, history, tracks_with_rows
from services.domain.benchmarks.phases.reported_results import ReportedRow, put_reported
from services.runtime.orm import Phase, Reported
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, HOUR_NS, Made, Scene, scene

NOW_NS = now_ns() // 1000 * 1000


@pytest.fixture
def at(platform: Platform) -> Scene:
    return scene(platform)


def ago(hours: float) -> int:
    return NOW_NS - int(hours * HOUR_NS)


def enter(at: Scene, hours: float, errors: float, **columns: object) -> str:
    columns.setdefault("finalized_ns", ago(hours))
    return at.enter(at.team(), Made(errors), settled_ns=ago(hours), **columns)


def changes(at: Scene, track: str = "all") -> tuple[BoardChange, ...]:
    with at.platform.database.reading() as session:
        return history(session, session.get_one(Phase, at.phase_id), track)  # type: ignore[arg-type]


def best_then(at: Scene, at_ns: int) -> float | None:
    shown = board(at.platform, at.phase_id, BoardQuery("all", at_ns), ADMINISTRATOR)
    ranked = [round(row.ratios["miou"] or 0.0, 4) for row in shown.rows if row.standing == "ranked"]
    return max(ranked, default=None)


def test_each_change_tells_the_best_of_the_board_as_it_stood_then(at: Scene) -> None:
    enter(at, 90, 0.5)
    enter(at, 80, 0.2, withdrawn_ns=ago(40))
    enter(at, 70, 0.3, hidden_ns=ago(30))
    enter(at, 60, 0.1, kind="baseline")
    enter(at, 50, 0.15, kind="validation")
    at.another_pair(ago(20))
    found = changes(at)
    assert [(one.entered, one.left, one.is_new_pair) for one in found] == [
        (0, 0, True),
        (1, 0, False),
        (1, 0, False),
        (1, 0, False),
        (1, 0, False),
        (0, 1, False),
        (0, 1, False),
        (0, 0, True),
    ]
    assert [one.best for one in found] == [best_then(at, one.at_ns) for one in found]
    assert found[-1].best is None


def test_between_two_changes_the_board_is_the_same(at: Scene) -> None:
    for hours, errors in ((50, 0.5), (40, 0.4), (30, 0.3)):
        enter(at, hours, errors)
    moments = [one.at_ns for one in changes(at)]
    for since, until in zip(moments, [*moments[1:], NOW_NS], strict=True):
        told = [
            board(at.platform, at.phase_id, BoardQuery("all", when), ADMINISTRATOR).rows
            for when in (since, until - 1000)
        ]
        assert [row.submission_id for row in told[0]] == [row.submission_id for row in told[1]]


def test_a_track_has_its_own_history(at: Scene) -> None:
    enter(at, 50, 0.5, modality="C")
    enter(at, 40, 0.2, modality="L")
    assert [one.entered for one in changes(at, "C")] == [0, 1]
    assert changes(at, "C")[-1].best == pytest.approx(best_then(at, ago(45)))


def test_tracks_are_told_of_entries_and_of_reported_rows(at: Scene) -> None:
    enter(at, 50, 0.5, modality="C")
    with at.platform.database.transaction() as session:
        put_reported(session, session.get_one(Phase, at.phase_id), [ReportedRow("Other", "L+R", "elsewhere", miou=0.1)])
        phase = session.get_one(Phase, at.phase_id)
        assert tracks_with_rows(session, phase) == {"C", "L+R"}
        put_at = session.query(Reported).one().created_ns
    assert changes(at)[-1].at_ns == -(-put_at // 1000) * 1000


def test_an_entry_withdrawn_before_it_was_scored_is_no_change(at: Scene) -> None:
    enter(at, 50, 0.5, withdrawn_ns=ago(60))
    assert [one.is_new_pair for one in changes(at)] == [True]


def test_many_changes_are_told_by_the_day_at_the_last_of_each(at: Scene) -> None:
    team = at.team()
    for number in range(MOST_CHANGES + 10):
        at.enter(team, settled_ns=ago(number / 4), finalized_ns=ago(number / 4))
    found = changes(at)
    days = {ago(number / 4) // DAY_NS for number in range(MOST_CHANGES + 10)}
    assert len(found) == len(days | {found[0].at_ns // DAY_NS})
    assert sum(one.entered for one in found) == MOST_CHANGES + 10
    assert found[-1].at_ns == NOW_NS
