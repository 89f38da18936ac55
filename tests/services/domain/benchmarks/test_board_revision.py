"""Boards that are kept: made again after each change that any of their viewers can see, and not before."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import pytest
from sqlalchemy import event
from sqlalchemy.orm import Session

from services.domain.benchmarks.boards import board as boards
from services.domain.benchmarks.boards.board import Board, board
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.boards.history import DAY_NS, MOST_CHANGES, BoardChange, history, tracks_with_rows
from services.domain.benchmarks.phases.reported_results import ReportedRow, put_reported
from services.domain.benchmarks.submissions.submissions import describe, hide, unhide, withdraw
from services.domain.benchmarks.visibility import ANYBODY, Viewer
from services.runtime.orm import Benchmark, Phase, Reported, SubmissionRow, Team
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, HOUR_NS, Made, Scene, scene

REPORTED = ReportedRow("Old", "L", "a paper", miou=0.2)
QUERIES = (BoardQuery(), BoardQuery(entries="all"), BoardQuery("L"), BoardQuery("C"))


@dataclass(frozen=True)
class Filled:
    """A phase with two entries of one team and one of another."""

    at: Scene
    teams: tuple[str, str]
    entries: tuple[str, str, str]

    @property
    def viewers(self) -> tuple[Viewer, ...]:
        members = (Viewer(team_ids=frozenset({team, "elsewhere"})) for team in self.teams)
        return (ANYBODY, Viewer(is_visitor=True), ADMINISTRATOR, *members)

    def boards(self) -> list[Board]:
        """What each viewer sees, whatever they ask for."""
        asked = [(viewer, query) for viewer in self.viewers for query in QUERIES]
        return [board(self.at.platform, self.at.phase_id, query, viewer) for viewer, query in asked]

    def submission(self, act: Callable[[Session, SubmissionRow], object]) -> None:
        """Do something to the best entry as its route does."""
        with self.at.platform.database.transaction() as session:
            act(session, session.get_one(SubmissionRow, self.entries[0]))

    def phase(self, act: Callable[[Session, Phase], object]) -> None:
        with self.at.platform.database.transaction() as session:
            act(session, session.get_one(Phase, self.at.phase_id))


def filled(platform: Platform) -> Filled:
    at = scene(platform)
    teams = (at.team(), at.team())
    entries = tuple(at.enter(teams[number % 2], Made(0.2 + number / 10)) for number in range(3))
    return Filled(at, teams, (entries[0], entries[1], entries[2]))


CHANGES: Mapping[str, Callable[[Filled], object]] = {
    "an entry is scored": lambda world: world.at.enter(world.teams[1], Made(0.1)),
    "a baseline is scored": lambda world: world.at.enter(world.teams[1], Made(0.1), kind="baseline"),
    "an entry of another track is scored": lambda world: world.at.enter(world.teams[1], Made(0.1), modality="C"),
    "a method is renamed": lambda world: world.submission(lambda s, one: describe(s, one, {"method": "Netter"})),
    "an entry is hidden": lambda world: world.submission(lambda s, one: hide(s, one, "why")),
    "an entry is withdrawn": lambda world: world.submission(withdraw),
    "a team is renamed": lambda world: world.at.change(world.teams[0], Team, name=f"renamed {world.teams[0]}"),
    "a result is reported": lambda world: world.phase(lambda s, phase: put_reported(s, phase, [REPORTED])),
    "another version is in force": lambda world: world.at.score(
        world.entries[0], Made(0.3), world.at.another_pair(now_ns())
    ),
    "the truth is hidden": lambda world: world.at.hide(),
    "the truth is hidden and the phase over": lambda world: world.at.end(),
    "teams are not named yet": lambda world: world.at.change(
        world.at.phase_id, Phase, named_from_ns=now_ns() + HOUR_NS
    ),
    "a phase is renamed": lambda world: world.at.change(world.at.phase_id, Phase, name="other"),
    "a benchmark is renamed": lambda world: world.at.change(
        world.at.place.phase.benchmark_id, Benchmark, name=f"other-{world.teams[0]}"
    ),
}


@pytest.mark.whole
@pytest.mark.parametrize("what", CHANGES)
def test_a_kept_board_is_the_one_that_would_be_made(platform: Platform, what: str) -> None:
    """Before and after the change, to each viewer, of each track."""
    world = filled(platform)
    before = world.boards()
    assert all(one is other for one, other in zip(world.boards(), before, strict=True))
    CHANGES[what](world)
    kept = world.boards()
    boards._KEPT.clear()
    assert kept == world.boards()
    assert [replace(one, revision="") for one in kept] != [replace(one, revision="") for one in before]


def test_what_was_undone_is_shown_as_before(platform: Platform) -> None:
    world = filled(platform)
    before = world.boards()
    world.submission(lambda session, one: hide(session, one, "why"))
    world.submission(unhide)
    assert world.boards() == before


def test_a_reported_result_that_changes_is_told_anew(platform: Platform) -> None:
    world = filled(platform)
    told = []
    for row in (REPORTED, replace(REPORTED, miou=0.3), replace(REPORTED, note="of another split")):
        world.phase(lambda session, phase, row=row: put_reported(session, phase, [row]))
        told.append([(one.ratios["miou"], one.note) for one in world.boards()[0].rows if one.standing == "reported"])
    assert told == [[(0.2, None)], [(0.3, None)], [(0.2, "of another split")]]


@pytest.mark.parametrize("column", ["named_from_ns", "closes_ns"])
def test_a_board_becomes_another_when_its_time_has_come(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, column: str
) -> None:
    """No row changes then."""
    world, now = filled(platform), now_ns()
    world.at.hide(**{column: now + HOUR_NS})
    before = world.boards()
    monkeypatch.setattr(boards, "now_ns", lambda: now + HOUR_NS)
    kept = world.boards()
    boards._KEPT.clear()
    assert kept == world.boards()
    assert kept != before


def test_nobody_is_shown_the_board_of_another_team(platform: Platform) -> None:
    world = filled(platform)
    for viewer in world.viewers * 2:
        shown = board(platform, world.at.phase_id, BoardQuery(entries="all"), viewer)
        yours = {row.submission_id for row in shown.rows if row.is_yours}
        first, second, third = world.entries
        expected = {world.teams[0]: {first, third}, world.teams[1]: {second}}
        assert yours == set().union(*(expected[team] for team in world.teams if team in viewer.team_ids))


def test_a_board_that_is_kept_costs_three_statements(platform: Platform) -> None:
    world, statements = filled(platform), list[str]()
    world.boards()
    engine = platform.database.engine
    event.listen(engine, "before_cursor_execute", lambda _c, _k, text, *_: statements.append(text))
    board(platform, world.at.phase_id, BoardQuery(), ANYBODY)
    assert len([text for text in statements if text.startswith("SELECT")]) == 3, statements


def test_boards_of_the_past_are_not_kept(platform: Platform) -> None:
    world, query = filled(platform), BoardQuery(as_of_ns=now_ns())
    kept = len(boards._KEPT)
    assert board(platform, world.at.phase_id, query, ANYBODY).revision == ""
    assert len(boards._KEPT) == kept


def test_a_board_that_changes_takes_the_place_of_the_one_before(platform: Platform) -> None:
    """However often entries are scored, no more is kept."""
    world = filled(platform)
    world.boards()
    kept = len(boards._KEPT)
    world.at.enter(world.teams[1], Made(0.1))
    world.boards()
    assert len(boards._KEPT) == kept


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


def test_a_track_has_its_own_history(at: Scene) -> None:
    enter(at, 50, 0.5, modality="C")
    enter(at, 40, 0.2, modality="L")
    assert [one.entered for one in changes(at, "C")] == [0, 1]
    assert changes(at, "C")[-1].best == pytest.approx(best_then(at, ago(45)))


def test_tracks_are_told_of_entries_and_of_reported_rows(at: Scene) -> None:
    enter(at, 50, 0.5, modality="C")
    with at.platform.database.transaction() as session:
        rows = [ReportedRow("Other", "L+R", "elsewhere"), ReportedRow("Ceiling", "R", "of all", kind="ceiling")]
        put_reported(session, session.get_one(Phase, at.phase_id), rows)
        phase = session.get_one(Phase, at.phase_id)
        assert tracks_with_rows(session, phase) == {"C", "L+R"}
        put_at = max(row.created_ns for row in session.query(Reported))
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
