"""Whatever is done at once, by teams, stages, sweepers and administrators: one has it, and the books are right.

**Conventions.** Which of two comes first is left to the machine; what must be true afterwards is true for every order.
Both databases: this is about their locks.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import pytest
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.alarms.alarms import open_alarms, raise_alarms
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, in_force
from services.domain.benchmarks.phases.ground_truths import start_truth
from services.domain.benchmarks.phases.phases import NewBenchmark, create_benchmark, create_phase
from services.domain.benchmarks.phases.reported_results import ReportedRow, put_reported
from services.domain.benchmarks.rescores.rescore import NewRescore, activate, start_rescore
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.submissions import cancel, finalise, mark_scoring, reopen, settle, withdraw
from services.domain.benchmarks.submissions.sweeper_chores import settle_ended, tidy_submissions
from services.domain.benchmarks.teams import teams
from services.domain.benchmarks.teams.teams import lock_team
from services.runtime.jobs import control
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import (
    Activation,
    Benchmark,
    Dataset,
    GroundTruthRow,
    Job,
    Phase,
    PhaseTeam,
    Reported,
    Rescore,
    ScoringEntry,
    SubmissionRow,
    TeamMember,
)
from services.runtime.platform import Platform
from services.runtime.uploads import expire
from stone.errors import StoneError
from stone.scoring.metric import METRIC_VERSION
from tests.services.domain.benchmarks import laid
from tests.services.domain.benchmarks.drafts import drafted, entrant_on, reserved, standing, uploaded
from tests.services.domain.benchmarks.scored import (
    Laid,
    Place,
    another_truth,
    entry,
    phase_of_rows,
    score,
    scored_entry,
    team,
)

DRAFTS = 12
LIMIT = 5
ENDS = ("scored", "invalid", "failed", "")
SETTLED_WITHIN_S = 300.0


class BrokenStageError(StoneError):
    """A stage refuses."""

    code = "broken_stage"

    def __init__(self) -> None:
        super().__init__("a stage refused")


def stage(platform: Platform, attempt: Attempt) -> Outcome:
    """Ends a submission in one of the ways there are, as its id has it."""
    submission_id = attempt.arguments["submission_id"]
    with platform.database.transaction() as session:
        mark_scoring(session, submission_id)
    end = ENDS[int(submission_id[-4:], 16) % len(ENDS)]
    if not end:
        raise BrokenStageError

    def commit(session: Session) -> None:
        settle(session, submission_id, end)

    return Outcome(commit=commit)


def tried_again(session: Session, row: SubmissionRow) -> None:
    if row.job_id is not None:
        reopen(session, control.retry(session, row.job_id, 3))


def test_the_books_are_right_whatever_happens_at_once(platform_on: Platform) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=LIMIT)
    drafts = [drafted(entrant) for _ in range(DRAFTS)]
    uploads = {submission_id: uploaded(entrant, submission_id) for submission_id in drafts}
    steps: tuple[Callable[[Session, SubmissionRow], object], ...] = (
        lambda session, row: finalise(session, row, uploads[row.id]),
        cancel,
        lambda session, row: finalise(session, row, uploads[row.id]),
        tried_again,
        withdraw,
    )
    is_over = threading.Event()

    def act(step: Callable[[Session, SubmissionRow], object], submission_id: str) -> None:
        unless_refused(lambda: in_one(platform_on, step, submission_id))

    with ThreadPoolExecutor(2) as beside, ThreadPoolExecutor(4) as acting:
        chores = [beside.submit(keep_on, platform_on, is_over) for _ in range(2)]
        try:
            list(acting.map(lambda pair: act(*pair), product(steps, drafts)))
            wait_until_settled(platform_on)
        finally:
            is_over.set()
        assert [one.result() for one in chores] == [None, None]
    with platform_on.database.reading() as session:
        rows = session.query(SubmissionRow).all()
        held = {row.id: sum(entry.amount for entry in entries_of(session, row)) for row in rows}
        assert held == {row.id: int(row.state == "scored") for row in rows}
        assert scoring_quota.balance(session, entrant.phase_id, entrant.team_id) == sum(held.values())


def keep_on(platform: Platform, is_over: threading.Event) -> None:
    """A worker and a sweeper."""
    while not is_over.is_set():
        unless_refused(lambda: run_next(platform, "eval", {"eval.open": partial(stage, platform)}))
        for chore in (settle_ended, tidy_submissions, expire):
            chore(platform)


def in_one(platform: Platform, step: Callable[[Session, SubmissionRow], object], submission_id: str) -> None:
    with platform.database.transaction() as session:
        step(session, session.get_one(SubmissionRow, submission_id))


def unless_refused(work: Callable[[], object]) -> None:
    """Refusals are expected; a deadlock or a broken constraint is not."""
    try:
        work()
    except StoneError:
        return


def entries_of(session: Session, row: SubmissionRow) -> list[ScoringEntry]:
    return session.query(ScoringEntry).filter_by(submission_id=row.id).all()


def wait_until_settled(platform: Platform) -> None:
    until_s = time.monotonic() + SETTLED_WITHIN_S
    while time.monotonic() < until_s:
        with platform.database.reading() as session:
            if not session.query(SubmissionRow).filter(SubmissionRow.state.in_(("queued", "scoring"))).count():
                return
        time.sleep(0.02)
    raise AssertionError("submissions are not settled")


def bound(platform: Platform) -> set[tuple[str, str]]:
    """(user, team) of everybody who takes part in a phase."""
    return {(row.user_id, row.team_id) for row in laid.rows(platform, select(PhaseTeam))}


def entered(platform: Platform, phase: Phase, *captains: Any) -> list[tuple[str, str]]:
    """A team of each of these in the phase: its id and an invitation to it."""
    made = []
    for captain in captains:
        row = laid.team(platform, captain)
        with platform.database.transaction() as session:
            teams.enter(session, phase, row.id)
            made.append((row.id, teams.invite(session, row, captain)))
    return made


def test_of_several_who_accept_the_last_seat_at_once_one_has_it(platform_on: Platform) -> None:
    ada = laid.user(platform_on)
    [(team_id, first)] = entered(platform_on, laid.hidden_phase(platform_on, team_members=2), ada)
    with platform_on.database.transaction() as session:
        row = lock_team(session, team_id)
        secrets = [first, *(teams.invite(session, row, ada) for _ in range(3))]
    acts = [partial(teams.join, secret=secret, user=laid.user(platform_on)) for secret in secrets]
    assert sorted(laid.at_once(platform_on, *acts)) == ["", *["team_full"] * 3]
    assert len(laid.members_of(platform_on, team_id)) == 2


def test_of_several_who_accept_one_invitation_at_once_one_is_in(platform_on: Platform) -> None:
    ada = laid.user(platform_on)
    [(team_id, secret)] = entered(platform_on, laid.hidden_phase(platform_on), ada)
    acts = [partial(teams.join, secret=secret, user=laid.user(platform_on)) for _ in range(4)]
    assert sorted(laid.at_once(platform_on, *acts)) == ["", *["no_invitation"] * 3]
    assert len(laid.members_of(platform_on, team_id)) == 2


def test_who_joins_two_teams_of_one_phase_at_once_is_in_one(platform_on: Platform) -> None:
    eve, phase = laid.user(platform_on), laid.hidden_phase(platform_on)
    of_phase = entered(platform_on, phase, *(laid.user(platform_on) for _ in range(3)))
    codes = laid.at_once(platform_on, *[partial(teams.join, secret=secret, user=eve) for _, secret in of_phase])
    assert sorted(codes) == ["", *["already_in_team"] * 2]
    memberships = laid.rows(platform_on, select(TeamMember.team_id).where(TeamMember.user_id == eve.id))
    assert {(eve.id, team_id) for team_id in memberships} == {pair for pair in bound(platform_on) if pair[0] == eve.id}


def test_teams_that_share_members_and_enter_at_once_do_not_both(platform_on: Platform) -> None:
    ada, eve, phase = laid.user(platform_on), laid.user(platform_on), laid.hidden_phase(platform_on)
    both = [laid.team(platform_on, ada, eve), laid.team(platform_on, eve, ada)]
    codes = laid.at_once(platform_on, *[partial(teams.enter, phase=phase, team_id=one.id) for one in both])
    assert sorted(codes) == ["", "already_in_team"]
    assert len({team_id for _, team_id in bound(platform_on)}) == 1


def test_of_teams_founded_at_once_with_names_that_look_alike_one_stands(platform_on: Platform) -> None:
    ada = laid.user(platform_on)
    acts = [partial(teams.create_team, name=name, user_id=ada.id) for name in ("Gang", "GANG", "gang")]
    assert sorted(laid.at_once(platform_on, *acts)) == ["", *["name_taken"] * 2]


def test_benchmarks_phases_and_ground_truths_are_made_one_at_a_time(platform_on: Platform) -> None:
    first = laid.hidden_phase(platform_on)
    (version,) = laid.rows(platform_on, select(Dataset))
    (benchmark,) = laid.rows(platform_on, select(Benchmark))
    asked = NewBenchmark("stone", "", "", version.created_by)
    for make, code in (
        (lambda session: create_benchmark(session, asked), "name_taken"),
        (lambda session: create_phase(session, benchmark, version, laid.VAL), "name_taken"),
        (lambda session: start_truth(session, first, version, version.created_by), "truth_in_making"),
    ):
        assert sorted(laid.at_once(platform_on, *[make] * 2)) == ["", code]
    with platform_on.database.transaction() as session:
        session.scalars(select(Job).where(Job.kind == "eval.truth")).one().state = "failed"
        start_truth(session, first, version, version.created_by)
    assert sorted(row.number for row in laid.rows(platform_on, select(GroundTruthRow))) == [1, 2]


def test_two_who_report_results_at_once_leave_the_rows_of_one(platform_on: Platform) -> None:
    phase = laid.hidden_phase(platform_on)
    one, other = (ReportedRow(f"{name} method", "C", "a paper") for name in "ab")
    lists = ([one, other], [replace(one, method="c method"), other])
    acts = [partial(put_reported, phase=phase, rows=rows) for rows in lists]
    assert laid.at_once(platform_on, *acts) == ["", ""]
    stand = {row.method for row in laid.rows(platform_on, select(Reported))}
    assert stand in ({"a method", "b method"}, {"c method", "b method"})


def rescored(place: Place, truth_id: str) -> Callable[[Session], tuple[str, str | None]]:
    """Starts a re-score by this ground truth; the ids of it and of its run."""
    asked = NewRescore(EvaluationVersion(truth_id, METRIC_VERSION), place.user.id, "labels corrected")

    def start(session: Session) -> tuple[str, str | None]:
        row, run = start_rescore(session, place.phase, asked)
        return row.id, run.id if run else None

    return start


def test_of_switches_of_the_board_at_once_one_passes(platform_on: Platform) -> None:
    place = phase_of_rows(platform_on)
    with platform_on.database.transaction() as session:
        shown = in_force(session, place.phase.id)
    ids = []
    for _ in range(4):
        start = rescored(place, another_truth(place))
        with platform_on.database.transaction() as session:
            ids.append(start(session)[0])

    def switch(session: Session, rescore_id: str) -> object:
        return activate(session, session.get_one(Rescore, rescore_id), shown.id, place.user.id)

    codes = laid.at_once(platform_on, *[partial(switch, rescore_id=rescore_id) for rescore_id in ids])
    assert sorted(codes) == ["", *["leaderboard_changed"] * 3]
    assert len(laid.rows(platform_on, select(Activation))) == 2


def test_starts_at_once_make_one_re_score_and_one_run(platform_on: Platform) -> None:
    place = phase_of_rows(platform_on)
    scored_entry(place, team(place))
    start, started = rescored(place, another_truth(place)), set[tuple[str, str | None]]()
    assert laid.at_once(platform_on, *[lambda session: started.add(start(session))] * 4) == [""] * 4
    assert len(started) == 1


def test_equal_entries_that_are_joined_at_the_same_moment_are_told(platform_on: Platform) -> None:
    place = phase_of_rows(platform_on)
    ids = [entry(place, team(place)) for _ in range(4)]

    def join(session: Session, submission_id: str) -> None:
        raise_alarms(session, score(session, place, submission_id, Laid()))

    assert laid.at_once(platform_on, *[partial(join, submission_id=one) for one in ids]) == [""] * 4
    told = laid.rows(platform_on, open_alarms(place.phase.id))
    assert sorted((alarm.kind, alarm.subject) for alarm in told) == [("equal_content", one) for one in ids[1:]]


def test_two_releases_of_a_scoring_at_once_give_back_one(
    platform_on: Platform, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both have begun before either has the team's lock; SQLite lets one begin at a time by itself."""
    entrant = entrant_on(platform_on, scorings_per_window=1)
    held, together = reserved(entrant), threading.Barrier(2)

    def locked(session: Session, team_id: str) -> None:
        if session.get_bind().dialect.name == "postgresql":
            together.wait(300)
        lock_team(session, team_id)

    given_back = list[int]()
    monkeypatch.setattr(scoring_quota, "lock_team", locked)
    acts = [lambda session: given_back.append(scoring_quota.release(session, held, "released: failed"))] * 2
    assert laid.at_once(platform_on, *acts) == ["", ""]
    assert sum(given_back) == 1
    with platform_on.database.reading() as session:
        assert scoring_quota.balance(session, entrant.phase_id, entrant.team_id) == 0


def test_of_many_scorings_at_once_exactly_as_many_pass_as_are_left(platform_on: Platform) -> None:
    entrant = entrant_on(platform_on, scorings_per_window=3)

    def reserve(session: Session, submission_id: str) -> None:
        scoring_quota.reserve(session, session.get_one(Phase, entrant.phase_id), entrant.team_id, submission_id)

    codes = laid.at_once(platform_on, *[partial(reserve, submission_id=drafted(entrant)) for _ in range(8)])
    assert sorted(codes) == [*[""] * 3, *["scorings_exhausted"] * 5]
    assert standing(entrant).reserved == 3
