"""A submission comes to be and is sent to be scored: all of it or nothing, and only what was announced."""

from typing import Any

import pytest

from services.domain.benchmarks.phases.errors import NoGroundTruthError
from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.errors import (
    HashMismatchError,
    PhaseClosedError,
    ScoringsExhaustedError,
    SubmissionStateError,
    SubmissionTooLargeError,
    TooManyOpenError,
    ValidationsExhaustedError,
)
from services.domain.benchmarks.submissions.scoring_jobs import OPEN
from services.domain.benchmarks.submissions.submissions import MOST_OPEN, cancel, largest_bytes, validations_left
from services.domain.benchmarks.teams.errors import AlreadyInTeamError
from services.runtime.jobs.control import set_mode
from services.runtime.jobs.errors import QueueDrainingError
from services.runtime.orm import Activation, Job, Phase, PhaseTeam, SubmissionRow, TeamMember, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.uploads.errors import UploadMissingError, UploadPurposeError, UploadStateError
from stone.errors import StoneError
from testing.servers.fixtures import Bells
from testing.worlds.made import NOBODY
from tests.services.domain.benchmarks.drafts import (
    ZIP,
    Entrant,
    another_entrant,
    drafted,
    entrant_on,
    finalised,
    seen,
    taken,
    uploaded,
)

HOUR_NS = 3600 * 10**9
DAY_NS = 24 * HOUR_NS


def upload_state(entrant: Entrant, upload_id: str) -> str:
    with entrant.platform.database.reading() as session:
        return session.get_one(Upload, upload_id).state


def assert_untouched(entrant: Entrant, submission_id: str, upload_id: str) -> None:
    """A draft and its upload are as they were, and nothing was taken or queued."""
    row = seen(entrant, submission_id)
    assert (row.state, row.upload_id, row.job_id, row.finalized_ns) == ("draft", None, None, None)
    assert upload_state(entrant, upload_id) == "complete"
    with entrant.platform.database.reading() as session:
        assert session.query(Job).filter_by(kind=OPEN).count() == session.query(PhaseTeam).count() == 0


def test_a_phase_that_is_not_open_takes_no_draft(platform: Platform) -> None:
    for rules in ({"opens_ns": now_ns() + DAY_NS}, {"closes_ns": now_ns() - DAY_NS}):
        with pytest.raises(PhaseClosedError):
            drafted(entrant_on(platform, **rules))


def test_a_phase_that_closed_meanwhile_takes_no_file(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with platform.database.transaction() as session:
        session.get_one(Phase, entrant.phase_id).closes_ns = now_ns()
    with pytest.raises(PhaseClosedError):
        finalised(entrant, submission_id, upload_id)
    assert_untouched(entrant, submission_id, upload_id)


def test_a_phase_without_a_ground_truth_takes_no_draft(platform: Platform) -> None:
    entrant = entrant_on(platform)
    with platform.database.transaction() as session:
        session.query(Activation).delete()
    with pytest.raises(NoGroundTruthError):
        drafted(entrant)


def test_a_file_larger_than_its_frames_is_refused_before_it_is_sent(platform: Platform) -> None:
    entrant = entrant_on(platform)
    limit_bytes = largest_bytes(2000)
    assert seen(entrant, drafted(entrant, size_bytes=limit_bytes)).size_bytes == limit_bytes
    with pytest.raises(SubmissionTooLargeError, match=f"{limit_bytes + 1} bytes, but 2000 frames"):
        drafted(entrant, size_bytes=limit_bytes + 1)


def test_a_team_has_a_bounded_number_of_open_submissions(platform: Platform) -> None:
    entrant = entrant_on(platform)
    drafts = [drafted(entrant) for _ in range(MOST_OPEN)]
    with pytest.raises(TooManyOpenError):
        drafted(entrant)
    drafted(another_entrant(entrant.place))
    with platform.database.transaction() as session:
        cancel(session, session.get_one(SubmissionRow, drafts[0]))
    drafted(entrant)


def test_an_entry_takes_its_upload_a_scoring_and_a_place_in_the_queue(platform: Platform, bells: Bells) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    finalised(entrant, submission_id, upload_id)
    row = seen(entrant, submission_id)
    assert (row.state, row.upload_id, row.revision) == ("queued", upload_id, 2)
    assert (upload_state(entrant, upload_id), taken(entrant)) == ("consumed", 1)
    with platform.database.reading() as session:
        bound = session.query(PhaseTeam).one()
        job = session.query(Job).filter_by(kind=OPEN).one()
        run = session.get_one(Job, job.root_id)
    assert (bound.user_id, bound.team_id) == (entrant.captain.user_id, entrant.team_id)
    assert job.arguments == {"submission_id": submission_id}
    assert (run.id, run.owner_id) == (row.job_id, entrant.captain.user_id)
    assert bells == [("eval", 1)]


@pytest.mark.parametrize("kind", ["validation", "baseline"])
def test_what_is_not_an_entry_costs_no_scoring(platform: Platform, kind: str) -> None:
    entrant = entrant_on(platform, scorings_total=0)
    finalised(entrant, kind=kind)
    assert taken(entrant) == 0


def test_a_baseline_costs_a_scoring_where_the_truth_is_hidden(platform: Platform) -> None:
    """The attack: as many looks at a hidden truth as a curator likes, by calling each a baseline."""
    entrant = entrant_on(platform, is_hidden=True, scorings_per_window=2)
    finalised(entrant, kind="baseline")
    finalised(entrant, kind="validation")
    finalised(entrant, kind="entry")
    assert taken(entrant) == 2
    with pytest.raises(ScoringsExhaustedError):
        finalised(entrant, kind="baseline")
    assert taken(entrant) == 2


def test_a_quota_that_is_used_up_leaves_draft_and_upload_for_later(platform: Platform) -> None:
    entrant = entrant_on(platform, scorings_per_window=0)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with pytest.raises(ScoringsExhaustedError):
        finalised(entrant, submission_id, upload_id)
    assert_untouched(entrant, submission_id, upload_id)
    with platform.database.transaction() as session:
        scoring_quota.grant(session, session.get_one(Phase, entrant.phase_id), entrant.team_id, 1)
    finalised(entrant, submission_id, upload_id)


def test_a_draining_queue_takes_nothing(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id)
    with platform.database.transaction() as session:
        set_mode(session, "eval", "draining")
    with pytest.raises(QueueDrainingError):
        finalised(entrant, submission_id, upload_id)
    assert_untouched(entrant, submission_id, upload_id)
    assert taken(entrant) == 0


def test_who_takes_part_with_another_team_cannot_submit_with_this_one(platform: Platform) -> None:
    entrant = entrant_on(platform)
    other = another_entrant(entrant.place)
    finalised(other)
    with platform.database.transaction() as session:
        session.add(TeamMember(team_id=entrant.team_id, user_id=other.captain.user_id))
    submission_id = drafted(entrant)
    with pytest.raises(AlreadyInTeamError):
        finalised(entrant, submission_id)
    with pytest.raises(AlreadyInTeamError):  # the one who is bound is told so before anything is sent
        drafted(entrant, user_id=other.captain.user_id)
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("draft", 0)


def test_a_submission_is_finalised_once(platform: Platform) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    first, second = uploaded(entrant, submission_id), uploaded(entrant, submission_id)
    finalised(entrant, submission_id, first)
    with pytest.raises(SubmissionStateError):
        finalised(entrant, submission_id, second)
    assert taken(entrant) == 1
    with platform.database.reading() as session:
        assert session.get_one(Upload, second).expires_ns <= now_ns()


@pytest.mark.parametrize(
    ("columns", "refusal"),
    [
        ({"state": "open"}, UploadStateError),
        ({"purpose": "recording"}, UploadPurposeError),
        ({"target_id": NOBODY}, UploadMissingError),
        ({"sha256": "1" * 64}, HashMismatchError),
        ({"length_bytes": len(ZIP) + 1}, HashMismatchError),
    ],
)
def test_only_the_announced_file_is_taken(
    platform: Platform, columns: dict[str, Any], refusal: type[StoneError]
) -> None:
    entrant = entrant_on(platform)
    submission_id = drafted(entrant)
    upload_id = uploaded(entrant, submission_id, **columns)
    with pytest.raises(refusal):
        finalised(entrant, submission_id, upload_id)
    assert upload_state(entrant, upload_id) == columns.get("state", "complete")
    assert (seen(entrant, submission_id).state, taken(entrant)) == ("draft", 0)


def test_an_upload_that_nobody_has_made_is_missing(platform: Platform) -> None:
    entrant = entrant_on(platform)
    with pytest.raises(UploadMissingError):
        finalised(entrant, drafted(entrant), NOBODY)


def test_validations_are_counted_by_the_day(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    entrant = entrant_on(platform, validations_per_day=2)
    waiting = drafted(entrant, kind="validation")
    finalised(entrant, kind="validation")
    failed = finalised(entrant, kind="validation")
    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, failed).state = "failed"
    finalised(entrant, waiting)
    with pytest.raises(ValidationsExhaustedError) as refused:
        drafted(entrant, kind="validation")
    next_ns = refused.value.next_ns
    assert next_ns is not None
    assert next_ns > now_ns() + DAY_NS - HOUR_NS
    finalised(entrant)
    monkeypatch.setattr("services.domain.benchmarks.submissions.submissions.now_ns", lambda: next_ns)
    drafted(entrant, kind="validation")


def test_where_no_validations_are_allowed_there_is_no_next_time(platform: Platform) -> None:
    entrant = entrant_on(platform, validations_per_day=0)
    with platform.database.reading() as session:
        assert validations_left(session, session.get_one(Phase, entrant.phase_id), entrant.team_id) == (0, None)
