"""A submission ends once, its scoring with it, whoever ends it; how long it still takes is judged by the last ones."""

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.completion_estimate import STEP_S, busy_ns, expected_s, queue_position
from services.domain.benchmarks.submissions.errors import SubmissionStateError
from services.domain.benchmarks.submissions.submissions import (
    cancel,
    describe,
    hide,
    mark_scoring,
    reopen,
    settle,
    settle_ended,
    unhide,
    withdraw,
)
from services.runtime.jobs import control
from services.runtime.jobs.claims import claim
from services.runtime.jobs.completion import Failure, fail
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import GroundTruthRow, Job, Phase, ScoringEntry, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.drafts import (
    Entrant,
    another_entrant,
    drafted,
    entrant_on,
    finalised,
    seen,
    standing,
    taken,
    uploaded,
)
from tests.services.runtime.jobs.steps import act

FOUND = {"ok": False, "errors": [{"code": "missing_frame"}], "errors_total": 1}


def ended(entrant: Entrant, submission_id: str, state: str, **found: object) -> bool:
    with entrant.platform.database.transaction() as session:
        return settle(session, submission_id, state, **found)  # type: ignore[arg-type]


def begun(entrant: Entrant, submission_id: str) -> None:
    act(entrant.platform, mark_scoring, submission_id)


def run_of(entrant: Entrant, submission_id: str) -> Job:
    with entrant.platform.database.reading() as session:
        return session.get_one(Job, seen(entrant, submission_id).job_id)


def failed_with(entrant: Entrant, failure: Failure) -> None:
    """The next job of `eval` is claimed and fails."""
    with entrant.platform.database.transaction() as session:
        taken_by_us = claim(session, "eval")
        assert taken_by_us is not None
    act(entrant.platform, fail, taken_by_us, failure)


def retried(entrant: Entrant, submission_id: str) -> None:
    """As the administrator's route does it."""
    with entrant.platform.database.transaction() as session:
        reopen(session, control.retry(session, seen(entrant, submission_id).job_id or "", 3))


@pytest.mark.parametrize(
    ("state", "held"), [("scored", 1), ("valid", 0), ("invalid", 0), ("failed", 0), ("cancelled", 0)]
)
def test_only_a_score_uses_a_scoring_up(platform: Platform, state: str, held: int) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    begun(entrant, submission_id)
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("scoring", 1)
    assert ended(entrant, submission_id, state)
    assert (seen(entrant, submission_id).state, taken(entrant)) == (state, held)
    assert seen(entrant, submission_id).settled_ns is not None
    assert not ended(entrant, submission_id, state)
    assert taken(entrant) == held


def used(entrant: Entrant, state: str, code: str = "") -> int:
    """How many scorings are used up when a further submission ends so while it is counted."""
    before = taken(entrant)
    submission_id = finalised(entrant)
    begun(entrant, submission_id)
    ended(entrant, submission_id, state, failure=Failure(code, "it ended") if code else None)
    return taken(entrant) - before


COUNTED_ENDS = [
    ("invalid", ""),
    ("cancelled", ""),
    ("failed", "scoring_crashed"),
    ("failed", "scoring_interrupted"),
    ("failed", "ground_truth_damaged"),
    ("failed", "time_limit"),
]


@pytest.mark.parametrize(("state", "code"), COUNTED_ENDS)
def test_of_a_hidden_truth_a_team_is_given_few_scorings_back(
    platform: Platform, state: str, code: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file that takes over the child that counts it chooses such an end by the truth: it may do so ten times."""
    entrant = entrant_on(platform, is_hidden=True)
    assert [used(entrant, state, code) for _ in range(12)] == [0] * 10 + [1, 1]
    assert (standing(entrant).used, standing(entrant).reserved) == (2, 0)
    other = another_entrant(entrant.place)
    assert used(other, state, code) == 0
    assert used(entrant, "failed", "worker_lost") == 0, "a fault that no child brings about costs nothing"
    later_ns = now_ns() + standing(entrant).window_ns
    monkeypatch.setattr(scoring_quota, "now_ns", lambda: later_ns)
    assert used(entrant, state, code) == 0


def test_of_an_open_truth_all_scorings_are_given_back(platform: Platform) -> None:
    entrant = entrant_on(platform, is_hidden=False)
    assert [used(entrant, "invalid") for _ in range(12)] == [0] * 12


def test_what_was_found_and_why_is_kept(platform: Platform) -> None:
    entrant = entrant_on(platform)
    first, second = finalised(entrant), finalised(entrant)
    ended(entrant, first, "invalid", problems=FOUND)
    ended(entrant, second, "failed", failure=Failure("scoring_crashed", "the reader ended"))
    assert seen(entrant, first).problems == FOUND
    assert (seen(entrant, second).failure_code, seen(entrant, second).failure) == (
        "scoring_crashed",
        "the reader ended",
    )


@pytest.mark.parametrize("write", [begun, lambda entrant, id: ended(entrant, id, "scored")], ids=["begun", "scored"])
def test_what_was_cancelled_takes_nothing_from_a_stage(
    platform: Platform, write: Callable[[Entrant, str], None]
) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    with platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, submission_id))
    with pytest.raises(JobCancelledError):
        write(entrant, submission_id)
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("cancelled", 0)


def test_a_score_that_comes_after_the_cancelling_is_rolled_back_whole(platform: Platform) -> None:
    """The stage had finished its work: what it would write beside the settling goes too, and its job is cancelled."""
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)

    def commit(session: Session) -> None:
        session.get_one(SubmissionRow, submission_id).method = "written beside"
        settle(session, submission_id, "scored")

    def stage(_attempt: Attempt) -> Outcome:
        return Outcome(commit=commit)

    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).state = "cancelled"  # after the last look at the wish to stop
    assert run_next(platform, "eval", {"eval.open": stage})
    assert seen(entrant, submission_id).method == "Net"
    assert run_of(entrant, submission_id).state == "succeeded"  # nobody had asked the run itself to stop
    with platform.database.reading() as session:
        assert session.query(Job).filter_by(kind="eval.open").one().state == "cancelled"


def test_a_score_by_another_pair_changes_nothing_of_one_that_is_scored(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    ended(entrant, submission_id, "scored")
    revision = seen(entrant, submission_id).revision
    begun(entrant, submission_id)
    assert not ended(entrant, submission_id, "scored")
    assert (seen(entrant, submission_id).revision, taken(entrant)) == (revision, 1)


@pytest.mark.parametrize(
    ("failure", "told"),
    [
        (Failure("worker_lost", "attempt 3 gave no sign of life"), ("worker_lost", "attempt 3 gave no sign of life")),
        (Failure("internal_error", "KeyError: 'a secret'"), ("internal_error", "a fault of the platform ended it")),
    ],
)
def test_a_run_that_failed_ends_its_submission(platform: Platform, failure: Failure, told: tuple[str, str]) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    assert settle_ended(platform) == 0
    failed_with(entrant, failure)
    assert (settle_ended(platform), settle_ended(platform)) == (1, 0)
    row = seen(entrant, submission_id)
    assert (row.state, taken(entrant)) == ("failed", 0)
    assert row.failure_code == told[0]
    assert row.failure.startswith(told[1])
    assert "secret" not in row.failure


@pytest.mark.parametrize("act", [control.cancel, control.terminate])
def test_a_run_that_was_stopped_cancels_its_submission(
    platform: Platform, act: Callable[[Session, str, str], Job]
) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    begun(entrant, submission_id)
    with platform.database.transaction() as session:
        act(session, seen(entrant, submission_id).job_id or "", "maintenance")
    assert settle_ended(platform) == 1
    row = seen(entrant, submission_id)
    assert (row.state, row.failure, taken(entrant)) == ("cancelled", "cancelled: maintenance", 0)


def test_a_run_that_forgot_its_submission_does_not_leave_it_waiting(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    assert run_next(platform, "eval", {"eval.open": lambda _attempt: Outcome()})
    assert settle_ended(platform) == 1
    assert (seen(entrant, submission_id).state, seen(entrant, submission_id).failure_code) == ("failed", "unsettled")


def test_what_is_tried_again_is_queued_again_and_paid_again(platform: Platform) -> None:
    entrant = entrant_on(platform, scorings_total=1)
    submission_id = finalised(entrant)
    failed_with(entrant, Failure("worker_lost", "gone"))
    settle_ended(platform)
    retried(entrant, submission_id)
    row = seen(entrant, submission_id)
    assert (row.state, row.failure_code, row.settled_ns, taken(entrant)) == ("queued", "", None, 1)
    assert settle_ended(platform) == 0
    ended(entrant, submission_id, "scored")
    assert taken(entrant) == 1


def test_what_is_tried_again_before_the_sweeper_came_was_never_given_back(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    failed_with(entrant, Failure("worker_lost", "gone"))
    retried(entrant, submission_id)
    assert settle_ended(platform) == 0
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("queued", 1)


def test_what_was_purged_is_not_tried_again(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    failed_with(entrant, Failure("worker_lost", "gone"))
    settle_ended(platform)
    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).upload_id = None
    with pytest.raises(SubmissionStateError):
        retried(entrant, submission_id)
    assert run_of(entrant, submission_id).state == "failed"


def test_cancelling_gives_the_scoring_back_and_stops_the_run(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    with platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, submission_id), "the wrong weights")
    row = seen(entrant, submission_id)
    assert (row.state, taken(entrant)) == ("cancelled", 0)
    assert row.settled_ns is not None
    with platform.database.reading() as session:
        assert {job.state for job in session.query(Job).filter_by(root_id=row.job_id)} == {"cancelled"}
    with pytest.raises(SubmissionStateError), platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, submission_id))
    with platform.database.reading() as session:
        assert [entry.amount for entry in session.query(ScoringEntry).order_by(ScoringEntry.id)] == [1, -1]


def test_cancelling_a_draft_ends_its_uploads(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, submission_id))
    with platform.database.reading() as session:
        assert session.get_one(Upload, upload_id).expires_ns <= now_ns()
    assert seen(entrant, submission_id).state == "cancelled"


def test_only_what_is_settled_is_withdrawn_and_once(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = finalised(entrant)
    with pytest.raises(SubmissionStateError):
        _withdrawn(entrant, submission_id)
    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).state = "scored"
    _withdrawn(entrant, submission_id)
    assert seen(entrant, submission_id).withdrawn_ns is not None
    assert taken(entrant) == 1
    with pytest.raises(SubmissionStateError):
        _withdrawn(entrant, submission_id)


def test_hiding_is_taken_back_without_a_trace(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    for reason in ("trained on test", "twice"):
        with platform.database.transaction() as session:
            hide(session, session.get_one(SubmissionRow, submission_id), reason)
    row = seen(entrant, submission_id)
    assert row.hidden_ns is not None
    assert (row.hidden_reason, row.revision) == ("twice", 3)
    with platform.database.transaction() as session:
        unhide(session, session.get_one(SubmissionRow, submission_id))
    row = seen(entrant, submission_id)
    assert (row.hidden_ns, row.hidden_reason) == (None, "")


def test_the_page_of_a_method_changes_and_its_track_does_not(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    with platform.database.transaction() as session:
        describe(session, session.get_one(SubmissionRow, submission_id), {"modality": "C+L"})
    finalised(entrant, submission_id)
    with platform.database.transaction() as session:
        row = session.get_one(SubmissionRow, submission_id)
        describe(session, row, {"method": "Net v2", "description": "Two\nlines", "modality": "C+L"})
        assert (row.method, row.description, row.modality) == ("Net v2", "Two\nlines", "C+L")
        revision = row.revision
        describe(session, row, {"method": "Net v2"})
        assert row.revision == revision
        with pytest.raises(SubmissionStateError):
            describe(session, row, {"modality": "L"})


def _withdrawn(entrant: Entrant, submission_id: str) -> None:
    with entrant.platform.database.transaction() as session:
        withdraw(session, session.get_one(SubmissionRow, submission_id))


SECOND = 10**9


def expected(entrant: Entrant, submission_id: str) -> int | None:
    with entrant.platform.database.reading() as session:
        return expected_s(session, session.get_one(SubmissionRow, submission_id))


def position(entrant: Entrant, submission_id: str) -> int | None:
    with entrant.platform.database.reading() as session:
        return queue_position(session, session.get_one(SubmissionRow, submission_id))


def read_through(entrant: Entrant, submission_id: str, begun_s: int, lasted_s: int) -> None:
    """As if its run had begun `begun_s` ago and scored it `lasted_s` later."""
    with entrant.platform.database.transaction() as session:
        row = session.get_one(SubmissionRow, submission_id)
        run = session.get_one(Job, row.job_id)
        run.started_ns = now_ns() - begun_s * SECOND
        row.state, row.settled_ns = "scored", run.started_ns + lasted_s * SECOND


def frames_of(entrant: Entrant, frames: int) -> None:
    with entrant.platform.database.transaction() as session:
        pair = evaluation_versions.active(session, session.get_one(Phase, entrant.phase_id).id)
        session.get_one(GroundTruthRow, pair.truth_id).frames = frames


def test_nothing_is_expected_before_anything_was_scored(platform: Platform) -> None:
    entrant = entrant_on(platform)
    first, second = finalised(entrant), finalised(another_entrant(entrant.place))
    assert [position(entrant, one) for one in (first, second)] == [0, 1]
    assert [expected(entrant, one) for one in (first, second)] == [None, None]


def test_whoever_waits_behind_more_frames_waits_longer(platform: Platform) -> None:
    entrant = entrant_on(platform)
    frames_of(entrant, 600)
    read_through(entrant, finalised(entrant), begun_s=900, lasted_s=60)
    waiting = [finalised(another_entrant(entrant.place)) for _ in range(3)]
    assert [expected(entrant, one) for one in waiting] == [60, 120, 180]
    frames_of(entrant, 60)
    assert expected(entrant, waiting[0]) == 60, "history and work are counted in the same frames"


def test_idle_hours_between_the_last_ones_do_not_slow_the_pace(platform: Platform) -> None:
    entrant = entrant_on(platform)
    read_through(entrant, finalised(entrant), begun_s=90_000, lasted_s=20)
    read_through(entrant, finalised(another_entrant(entrant.place)), begun_s=60, lasted_s=20)
    assert expected(entrant, finalised(another_entrant(entrant.place))) == 20


def test_two_workers_at_once_count_as_two(platform: Platform) -> None:
    entrant = entrant_on(platform)
    for begun_s in (100, 100):
        read_through(entrant, finalised(another_entrant(entrant.place)), begun_s=begun_s, lasted_s=40)
    assert expected(entrant, finalised(entrant)) in (20, 25), "the two began some microseconds apart"


def test_nothing_is_expected_of_what_has_ended_nor_of_a_paused_queue(platform: Platform) -> None:
    entrant = entrant_on(platform)
    done = finalised(entrant)
    read_through(entrant, done, begun_s=60, lasted_s=1)
    assert expected(entrant, done) is None
    waiting = finalised(another_entrant(entrant.place))
    assert expected(entrant, waiting) == STEP_S
    act(entrant.platform, set_mode, "eval", "paused")
    assert expected(entrant, waiting) is None


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 20)), max_size=12))
def test_busy_time_is_the_number_of_moments_that_any_span_holds(spans: list[tuple[int, int]]) -> None:
    given_spans = [(start, start + length) for start, length in spans]
    held = {moment for start, stop in given_spans for moment in range(start, stop)}
    assert busy_ns(given_spans) == len(held)
