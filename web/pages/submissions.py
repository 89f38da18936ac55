"""The pages of a team's submissions: the list, and one with its progress, findings and actions."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse
from sqlalchemy.orm import Session

from api.deps import Caller, PlatformDep, Reader, at_once
from api.etags import etag
from api.paging import PageDep
from api.paging import page as paged
from api.routes.submissions import SubmissionFilters
from api.schemas.base import IdPath
from api.schemas.leaderboard import RatiosItem
from api.views.results import viewer_for
from api.views.submissions import submission_detail, submission_items, validation_report
from api.visible import submission_of, submissions_of, teams_of
from services.domain.benchmarks.modalities import MODALITIES
from services.domain.benchmarks.submissions.result_errors import NotScoredError, ScoreMissingError
from services.domain.benchmarks.submissions.results import results
from services.domain.benchmarks.submissions.state_machine import ENDED, LIVE, OPEN
from services.domain.benchmarks.teams.teams import is_member
from services.runtime.orm import SubmissionRow
from web.problem_words import grouped
from web.rendering import page
from web.words import phase_names, team_names

router = APIRouter()
STATES = ("draft", *LIVE, *ENDED)
Narrowed = Annotated[SubmissionFilters, Depends(at_once(SubmissionFilters))]


@router.get("/submissions")
def list_submissions(
    request: Request, caller: Reader, platform: PlatformDep, query: PageDep, filters: Narrowed
) -> HTMLResponse:
    with platform.database.reading() as session:
        rows = paged(session, filters.narrowed(submissions_of(caller)), SubmissionRow.id.desc(), query)
        items = submission_items(session, rows.rows)
        values: dict[str, Any] = {
            "items": items,
            "next": rows.next,
            "phases": phase_names(session, [item.phase_id for item in items]),
            "teams": team_names(session, [item.team_id for item in items]),
            "has_team": session.scalars(teams_of(caller).limit(1)).first() is not None,
        }
    is_live = any(item.state in LIVE for item in items)
    return page(request, caller, "submissions/list.html", filters=filters, states=STATES, is_live=is_live, **values)


@router.get("/submissions/{submission_id}")
def show_submission(
    submission_id: IdPath, request: Request, caller: Reader, platform: PlatformDep, known: bool = False
) -> HTMLResponse:
    """Show a submission; the form sets `known` if this very file was submitted before."""
    with platform.database.reading() as session:
        row = submission_of(session, caller, submission_id)
        shown, report = submission_detail(session, row), validation_report(row)
        values: dict[str, Any] = {
            "phase": phase_names(session, [row.phase_id])[row.phase_id],
            "team": team_names(session, [row.team_id])[row.team_id],
            "total": _total(session, caller, row),
            "is_mine": is_member(session, row.team_id, caller.user_id),
        }
    values |= {"report": report, "groups": grouped(report.errors), "match": etag(shown.revision), "known": known}
    values |= {"is_live": shown.state in LIVE, "is_open": shown.state in OPEN, "modalities": MODALITIES}
    return page(request, caller, "submissions/one.html", it=shown, **values)


def _total(session: Session, caller: Caller, row: SubmissionRow) -> RatiosItem | None:
    """Return its ratios by the active version, as far as the caller may see them; None without such a score."""
    if row.state != "scored":
        return None
    try:
        scored = results(session, viewer_for(session, caller), row)
    except (NotScoredError, ScoreMissingError):
        return None
    return RatiosItem(**scored.total)
