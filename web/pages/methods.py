"""The page of a method: the scores of an entry, its strengths and their sources."""

from typing import Annotated

from fastapi import APIRouter, Query, Request
from fastapi.responses import HTMLResponse

from api.deps import Looker, PlatformDep
from api.schemas.base import ID_PATTERN, IdPath
from api.schemas.leaderboard import BoardRow
from api.schemas.results import BreakdownAnswer, ProvenanceAnswer, ScoreQuery
from api.views.results import (
    breakdown_answer,
    known_score,
    known_submission,
    provenance_answer,
    results_answer,
    viewer_for,
)
from services.domain.benchmarks.phases.open_frames import locate_open_truth
from services.domain.benchmarks.submissions.results import BY, ScoreView, breakdown, provenance, results
from services.runtime.orm import Benchmark
from web.boards.open_example import chosen_frame
from web.boards.results import CLASS_NAMES, breakdowns, matrix, totals
from web.boards.rows import ShownBoard, shown_board
from web.rendering import page

router = APIRouter()
FrameQuery = Annotated[str | None, Query(pattern=ID_PATTERN, description="token of the frame to show")]


@router.get("/entries/{submission_id}")
def show_method(
    request: Request,
    submission_id: IdPath,
    caller: Looker,
    platform: PlatformDep,
    score: ScoreQuery = None,
    frame: FrameQuery = None,
) -> HTMLResponse:
    with platform.database.reading() as session:
        viewer = viewer_for(session, caller)
        scored = results(session, viewer, known_submission(session, viewer, submission_id), score)
        answer = results_answer(session, viewer, scored)
        seen = known_score(session, caller, submission_id, score)
        breakdown_answers, made_by = _breakdowns(seen), _provenance(seen)
        truth = locate_open_truth(session, seen.phase, seen.truth) if seen.submission.blob_sha256 else None
        title = session.get_one(Benchmark, seen.phase.benchmark_id).title or answer.benchmark
    board = shown_board(platform, seen.phase.id, viewer)
    return page(
        request,
        caller,
        "boards/entry.html",
        benchmark_title=title,
        phase=seen.phase,
        result=answer,
        is_active=seen.is_active,
        is_standing=_stands(seen),
        is_own=seen.submission.team_id in viewer.team_ids,
        shows_counts=seen.policy.shows("confusions"),
        frame=chosen_frame(platform, truth, frame) if seen.policy.shows("frames") else None,
        score_query=f"&score={score}" if score else "",
        totals=totals(answer),
        breakdowns=breakdowns(breakdown_answers),
        matrix=matrix(answer.confusion),
        class_names=CLASS_NAMES,
        provenance=made_by,
        board=board,
        row=_row(board, submission_id),
        rivals=_rivals(board, submission_id),
    )


def _breakdowns(seen: ScoreView) -> list[BreakdownAnswer]:
    """Return the breakdowns; none if the viewer may not see them."""
    if not seen.policy.shows("breakdowns"):
        return []
    return [breakdown_answer(seen, by, breakdown(seen, by)) for by in BY]


def _provenance(seen: ScoreView) -> ProvenanceAnswer | None:
    return provenance_answer(provenance(seen)) if seen.policy.shows("provenance") else None


def _stands(seen: ScoreView) -> bool:
    """Return whether the submission is on the board, neither withdrawn nor hidden."""
    return seen.submission.withdrawn_ns is None and seen.submission.hidden_ns is None


def _row(board: ShownBoard, submission_id: str) -> BoardRow | None:
    """Return the entry's row of the current board, if it is the best of its team."""
    rows = (shown.row for group in board.groups for shown in group.rows)
    return next((row for row in rows if row.submission_id == submission_id), None)


def _rivals(board: ShownBoard, submission_id: str) -> list[BoardRow]:
    """Return the other scored rows of the board, for comparisons."""
    rows = (shown.row for group in board.groups for shown in group.rows)
    return [row for row in rows if row.submission_id not in (None, submission_id)]
