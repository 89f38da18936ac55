"""Routes of submissions: create, finalize, list, change, cancel, withdraw; and the team's quota.

**Conventions.** Only the members of its team and administrators can see a submission here; for others it does not exist
(the board decides its own visibility). The ETag is the submission's revision, which changes with its state and its
page, not with its progress. The file is sent through `/uploads` between creation and finalisation.
"""

from dataclasses import dataclass
from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response
from sqlalchemy import Select

from api import audit
from api.answers import refusals
from api.deps import Administrator, Caller, PlatformDep, Reader, Submitter, at_once
from api.errors import ForbiddenError
from api.etags import require_match, set_head
from api.lists.answers import listed, model_response
from api.paging import Page, PageDep, page
from api.row_readers import by_row_readers
from api.schemas.admin import CancelBody
from api.schemas.base import IdPath, IdQuery
from api.schemas.submissions import (
    FinalizeBody,
    Kind,
    NewSubmissionBody,
    NewValidationBody,
    StandingAnswer,
    State,
    SubmissionChangesBody,
    SubmissionDetail,
    SubmissionItem,
    ValidationReport,
    VisibilityBody,
)
from api.views.submissions import quota_answer, submission_detail, submission_items, validation_report
from api.visible import member_team_of, phase_of, submission_of, submissions_of, team_of
from services.domain.benchmarks.submissions import submissions
from services.domain.benchmarks.submissions.state_machine import lock_submission
from services.domain.benchmarks.submissions.submissions import SubmissionDraft
from services.runtime.orm import SubmissionRow
from services.runtime.platform import Platform

router = APIRouter(tags=["submissions"])


@dataclass(frozen=True)
class SubmissionFilters:
    """Which submissions a list shows."""

    phase_id: IdQuery = None
    team_id: IdQuery = None
    state: State | None = None
    kind: Kind | None = None

    def narrowed(self, statement: Select[SubmissionRow]) -> Select[SubmissionRow]:
        return statement.filter_by(**{key: value for key, value in vars(self).items() if value is not None})


@router.post(
    "/phases/{phase_id}/submissions",
    summary="Create a submission as a draft, declaring the zip to be uploaded",
    status_code=201,
    responses=refusals(403, 404, 409),
)
def create_submission(
    phase_id: IdPath, body: NewSubmissionBody, caller: Submitter, platform: PlatformDep, response: Response
) -> SubmissionDetail:
    """Create a submission as a draft, declaring the zip to be uploaded."""
    if body.kind == "baseline" and caller.role == "participant":
        raise ForbiddenError("only curators and administrators can submit baselines; submit an entry")
    return _announced(platform, caller, phase_id, (body.kind, body), response)


@router.post("/phases/{phase_id}/validations", status_code=201, responses=refusals(404, 409))
def create_validation(
    phase_id: IdPath, body: NewValidationBody, caller: Submitter, platform: PlatformDep, response: Response
) -> SubmissionDetail:
    """Create a validation-only submission: it is checked, never scored and does not count towards the quota."""
    return _announced(platform, caller, phase_id, ("validation", body), response)


@router.post(
    "/submissions/{submission_id}/finalize",
    summary="Submit the uploaded file for checks and scoring",
    status_code=202,
    responses=refusals(404, 409),
)
def finalize_submission(
    submission_id: IdPath, body: FinalizeBody, caller: Submitter, platform: PlatformDep, response: Response
) -> SubmissionDetail:
    """Start the checks and the scoring; a validation is only checked. The job at `Location` reports the progress."""
    with platform.database.transaction() as session:
        row = submission_of(session, caller, submission_id)
        job = submissions.finalise(session, row, body.upload_id)
        facts = {"phase_id": row.phase_id, "team_id": row.team_id, "kind": row.kind, "job_id": job.id}
        audit.record(session, caller, "submission.finalize", row.id, facts=facts)
        shown = submission_detail(session, lock_submission(session, row.id))
    return set_head(response, shown, tag=shown.revision, location=f"/api/v1/jobs/{job.id}")


@router.get("/submissions", response_model=Page[SubmissionItem], responses=listed())
@by_row_readers
def list_submissions(
    request: Request,
    caller: Reader,
    platform: PlatformDep,
    query: PageDep,
    filters: Annotated[SubmissionFilters, Depends(at_once(SubmissionFilters))],
) -> Response:
    """List the submissions of your teams, newest first; administrators see all submissions."""
    with platform.database.lookups() as session:
        submission_page = page(session, filters.narrowed(submissions_of(caller)), SubmissionRow.id.desc(), query)
        shown = Page[SubmissionItem](items=submission_items(session, submission_page.rows), next=submission_page.next)
    return model_response(request, shown)


@router.get("/submissions/{submission_id}", summary="Show a submission", responses=refusals(404))
def show_submission(
    submission_id: IdPath, caller: Reader, platform: PlatformDep, response: Response
) -> SubmissionDetail:
    """Show a submission: its progress, and the reason if it was not scored."""
    with platform.database.reading() as session:
        shown = submission_detail(session, submission_of(session, caller, submission_id))
    return set_head(response, shown, tag=shown.revision)


@router.patch("/submissions/{submission_id}", responses=refusals(404, 409, 412, 428))
def change_submission(
    submission_id: IdPath,
    body: SubmissionChangesBody,
    caller: Submitter,
    platform: PlatformDep,
    request: Request,
    response: Response,
) -> SubmissionDetail:
    """Change the method page of a submission."""
    with platform.database.transaction() as session:
        row = lock_submission(session, submission_of(session, caller, submission_id).id)
        require_match(request, row.revision)
        changes = {key: value for key, value in body if value is not None}
        submissions.describe(session, row, changes)
        audit.record(session, caller, "submission.describe", row.id, facts=changes)
        shown = submission_detail(session, row)
    return set_head(response, shown, tag=shown.revision)


@router.get("/submissions/{submission_id}/validation-report", responses=refusals(404))
def show_validation_report(submission_id: IdPath, caller: Reader, platform: PlatformDep) -> ValidationReport:
    """List the problems of the file: the first hundred and the total number."""
    with platform.database.reading() as session:
        return validation_report(submission_of(session, caller, submission_id))


@router.post("/submissions/{submission_id}/cancel", responses=refusals(404, 409))
def cancel_submission(
    submission_id: IdPath, caller: Submitter, platform: PlatformDep, body: CancelBody | None = None
) -> SubmissionDetail:
    """Cancel an unsettled submission; its quota is released."""
    reason = body.reason if body else ""
    with platform.database.transaction() as session:
        row = submissions.cancel(session, submission_of(session, caller, submission_id), reason)
        audit.record(session, caller, "submission.cancel", row.id, reason)
        return submission_detail(session, row)


@router.post("/submissions/{submission_id}/withdraw", responses=refusals(404, 409))
def withdraw_submission(
    submission_id: IdPath, caller: Submitter, platform: PlatformDep, body: CancelBody | None = None
) -> SubmissionDetail:
    """Withdraw a settled submission from every leaderboard. It is permanent, and still counts towards the quota."""
    with platform.database.transaction() as session:
        row = submissions.withdraw(session, submission_of(session, caller, submission_id))
        audit.record(session, caller, "submission.withdraw", row.id, body.reason if body else "")
        return submission_detail(session, row)


@router.get("/phases/{phase_id}/teams/{team_id}/quota", responses=refusals(404))
def show_quota(phase_id: IdPath, team_id: IdPath, caller: Reader, platform: PlatformDep) -> StandingAnswer:
    """Show the team's quota: used, left, and the time of the next available submission."""
    with platform.database.reading() as session:
        team = team_of(session, caller, team_id)
        return quota_answer(session, phase_of(session, phase_id), team.id)


@router.put(
    "/admin/submissions/{submission_id}/visibility",
    summary="Hide a submission from all leaderboards, or show it",
    responses=refusals(403, 404),
)
def change_submission_visibility(
    submission_id: IdPath, body: VisibilityBody, caller: Administrator, platform: PlatformDep
) -> SubmissionDetail:
    with platform.database.transaction() as session:
        row = submission_of(session, caller, submission_id)
        row = submissions.hide(session, row, body.reason) if body.hidden else submissions.unhide(session, row)
        facts = {"phase_id": row.phase_id, "team_id": row.team_id}
        act = "submission.hide" if body.hidden else "submission.unhide"
        audit.record_admin_act(session, caller, act, row.id, body.reason, facts)
        return submission_detail(session, row)


def _announced(
    platform: Platform, caller: Caller, phase_id: str, asked: tuple[str, NewValidationBody], response: Response
) -> SubmissionDetail:
    kind, body = asked
    with platform.database.transaction() as session:
        team = member_team_of(session, caller, body.team_id)
        phase = phase_of(session, phase_id)
        declared = body.model_dump(exclude={"team_id", "kind"})
        row = submissions.create_draft(session, SubmissionDraft(phase.id, team.id, caller.user_id, kind, **declared))
        facts = {"phase_id": phase.id, "team_id": team.id, "kind": kind, "sha256": body.sha256}
        audit.record(session, caller, "submission.announce", row.id, facts=facts)
        shown = submission_detail(session, row)
    return set_head(response, shown, tag=shown.revision, location=f"/api/v1/submissions/{shown.id}")
