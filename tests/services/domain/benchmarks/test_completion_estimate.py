"""How long a submission still takes is judged by the last ones, and said only where there is something to judge by."""

from hypothesis import given
from hypothesis import strategies as st

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.submissions.completion_estimate import STEP_S, busy_ns, expected_s, queue_position
from services.runtime.jobs.control import set_mode
from services.runtime.orm import GroundTruthRow, Job, Phase, SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.drafts import Entrant, another_entrant, entrant_on, finalised

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
    with entrant.platform.database.transaction() as session:
        set_mode(session, "eval", "paused")
    assert expected(entrant, waiting) is None


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 20)), max_size=12))
def test_busy_time_is_the_number_of_moments_that_any_span_holds(spans: list[tuple[int, int]]) -> None:
    given_spans = [(start, start + length) for start, length in spans]
    held = {moment for start, stop in given_spans for moment in range(start, stop)}
    assert busy_ns(given_spans) == len(held)
