"""A submission is cancelled, withdrawn, hidden, described anew: each only where it can be."""

import pytest

from services.domain.benchmarks.submissions.errors import SubmissionStateError
from services.domain.benchmarks.submissions.submissions import cancel, describe, hide, unhide, withdraw
from services.runtime.orm import Job, ScoringEntry, SubmissionRow, Upload
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.domain.benchmarks.drafts import Entrant, drafted, entrant_on, finalised, seen, taken, uploaded


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
    with (
        pytest.raises(SubmissionStateError, match="is cancelled and cannot be cancelled now"),
        platform.database.transaction() as session,
    ):
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
    with pytest.raises(SubmissionStateError, match="is queued and cannot be withdrawn"):
        _withdrawn(entrant, submission_id)
    with platform.database.transaction() as session:
        session.get_one(SubmissionRow, submission_id).state = "scored"
    _withdrawn(entrant, submission_id)
    assert seen(entrant, submission_id).withdrawn_ns is not None
    assert taken(entrant) == 1
    with pytest.raises(SubmissionStateError, match="withdrawn already"):
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
        with pytest.raises(SubmissionStateError, match="cannot be moved to another track"):
            describe(session, row, {"modality": "L"})


def _withdrawn(entrant: Entrant, submission_id: str) -> None:
    with entrant.platform.database.transaction() as session:
        withdraw(session, session.get_one(SubmissionRow, submission_id))
