"""How long a submission still takes is judged by the last ones, and said only where there is something to judge by."""

from hypothesis import given
from hypothesis import strategies as st

from services.runtime.benchmarks import pairs
from services.runtime.benchmarks.expecting import STEP_S, busy_ns, expected_s, queue_position
from services.runtime.jobs.steering import set_mode
from services.runtime.orm import GroundTruth, Job, Phase, Submission
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.runtime.benchmarks.drafts import Desk, another_desk, desk_on, finalised

SECOND = 10**9


def expected(desk: Desk, submission_id: str) -> int | None:
    with desk.platform.database.reading() as session:
        return expected_s(session, session.get_one(Submission, submission_id))


def position(desk: Desk, submission_id: str) -> int | None:
    with desk.platform.database.reading() as session:
        return queue_position(session, session.get_one(Submission, submission_id))


def read_through(desk: Desk, submission_id: str, begun_s: int, lasted_s: int) -> None:
    """As if its run had begun `begun_s` ago and scored it `lasted_s` later."""
    with desk.platform.database.transaction() as session:
        row = session.get_one(Submission, submission_id)
        run = session.get_one(Job, row.job_id)
        run.started_ns = now_ns() - begun_s * SECOND
        row.state, row.settled_ns = "scored", run.started_ns + lasted_s * SECOND


def frames_of(desk: Desk, frames: int) -> None:
    with desk.platform.database.transaction() as session:
        pair = pairs.active(session, session.get_one(Phase, desk.phase_id).id)
        assert pair is not None
        session.get_one(GroundTruth, pair.truth_id).frames = frames


def test_nothing_is_expected_before_anything_was_scored(platform: Platform) -> None:
    desk = desk_on(platform)
    first, second = finalised(desk), finalised(another_desk(desk.place))
    assert [position(desk, one) for one in (first, second)] == [0, 1]
    assert [expected(desk, one) for one in (first, second)] == [None, None]


def test_whoever_waits_behind_more_frames_waits_longer(platform_on: Platform) -> None:
    desk = desk_on(platform_on)
    frames_of(desk, 600)
    read_through(desk, finalised(desk), begun_s=900, lasted_s=60)
    waiting = [finalised(another_desk(desk.place)) for _ in range(3)]
    assert [expected(desk, one) for one in waiting] == [60, 120, 180]
    frames_of(desk, 60)
    assert expected(desk, waiting[0]) == 60, "history and work are counted in the same frames"


def test_idle_hours_between_the_last_ones_do_not_slow_the_pace(platform: Platform) -> None:
    desk = desk_on(platform)
    read_through(desk, finalised(desk), begun_s=90_000, lasted_s=20)
    read_through(desk, finalised(another_desk(desk.place)), begun_s=60, lasted_s=20)
    assert expected(desk, finalised(another_desk(desk.place))) == 20


def test_two_workers_at_once_count_as_two(platform: Platform) -> None:
    desk = desk_on(platform)
    for begun_s in (100, 100):
        read_through(desk, finalised(another_desk(desk.place)), begun_s=begun_s, lasted_s=40)
    assert expected(desk, finalised(desk)) in (20, 25), "the two began some microseconds apart"


def test_nothing_is_expected_of_what_has_ended_nor_of_a_paused_queue(platform: Platform) -> None:
    desk = desk_on(platform)
    done = finalised(desk)
    read_through(desk, done, begun_s=60, lasted_s=1)
    assert expected(desk, done) is None
    waiting = finalised(another_desk(desk.place))
    assert expected(desk, waiting) == STEP_S
    with desk.platform.database.transaction() as session:
        set_mode(session, "eval", "paused")
    assert expected(desk, waiting) is None


@given(st.lists(st.tuples(st.integers(0, 60), st.integers(0, 20)), max_size=12))
def test_busy_time_is_the_number_of_moments_that_any_span_holds(spans: list[tuple[int, int]]) -> None:
    given_spans = [(start, start + length) for start, length in spans]
    held = {moment for start, stop in given_spans for moment in range(start, stop)}
    assert busy_ns(given_spans) == len(held)
