"""Whatever is done to submissions at once, by teams, stages, sweepers and administrators: the books are right.

**Conventions.** Which of two comes first is left to the machine; what must be true afterwards is true for every order.
"""

import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import product

from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.chores import settle_ended, tidy_submissions
from services.domain.benchmarks.submissions.submissions import cancel, finalise, mark_scoring, reopen, settle, withdraw
from services.runtime.jobs import control
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import ScoringEntry, SubmissionRow
from services.runtime.platform import Platform
from services.runtime.uploads import expire
from stone.errors import StoneError
from tests.services.domain.benchmarks.drafts import drafted, entrant_on, uploaded

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
