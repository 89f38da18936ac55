"""Routes of a phase's leaderboard: the board, its history, and the comparison of two entries.

**Conventions.** Signed-in users can read all boards, visitors those of public benchmarks; visibility is checked where
rows are read (`services/domain/benchmarks/visibility.py`). The ETag is the hash of the bytes, so an unchanged board is
not sent again.
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response

from api.answers import Responses, refusals
from api.deps import Looker, PlatformDep, at_once
from api.routes.benchmarks import AT, AtPhase
from api.schemas.leaderboard import (
    AsOfQuery,
    ComparisonAnswer,
    EntriesQuery,
    FormQuery,
    HistoryAnswer,
    LeaderboardAnswer,
    SubmissionQuery,
    TrackQuery,
)
from api.schemas.phase_bodies import ns_of
from api.views.boards import JSON_TYPE, board_response, comparison_answer, history_answer
from api.views.results import known_submission, viewer_for
from services.domain.benchmarks.boards.board import board
from services.domain.benchmarks.boards.comparison import compare
from services.domain.benchmarks.boards.entries import BoardQuery
from services.domain.benchmarks.boards.tables import MEDIA_TYPES

router = APIRouter(prefix=AT, tags=["benchmarks"])
BINARY = {"schema": {"type": "string", "format": "binary"}}
FORMS = {
    JSON_TYPE: {"schema": {"$ref": "#/components/schemas/LeaderboardAnswer"}},
    **{media_type.partition(";")[0]: BINARY for media_type in MEDIA_TYPES.values()},
}
BOARD: Responses = {200: {"content": FORMS}, 304: {"description": "The caller's copy is current"}, **refusals(404)}


class BoardRequest:
    """The parameters of a board, and its form."""

    def __init__(
        self,
        track: TrackQuery = "all",
        as_of: AsOfQuery = None,
        entries: EntriesQuery = "best",
        form: FormQuery = "json",
    ) -> None:
        self.query = BoardQuery(track, None if as_of is None else ns_of(as_of), entries)
        self.form = form


BoardRequestDep = Annotated[BoardRequest, Depends(at_once(BoardRequest))]


@router.get("/leaderboard", summary="Show the leaderboard", response_model=LeaderboardAnswer, responses=BOARD)
def show_leaderboard(
    at: AtPhase, asked: BoardRequestDep, caller: Looker, platform: PlatformDep, request: Request
) -> Response:
    """Return ranks with intervals and ties, baselines and reported results, at the present or at `as_of`."""
    with platform.database.lookups() as session:
        phase_id, viewer = at.find_id(session), viewer_for(session, caller)
    return board_response(request, board(platform, phase_id, asked.query, viewer), viewer, asked.form)


@router.get("/leaderboard/history", summary="List the changes of the leaderboard", responses=refusals(404))
def show_leaderboard_history(at: AtPhase, platform: PlatformDep, track: TrackQuery = "all") -> HistoryAnswer:
    """Return each change with its time and the best mIoU since."""
    with platform.database.reading() as session:
        return history_answer(session, at.find(session), track)


@router.get("/compare", summary="Compare two entries", responses=refusals(404, 409))
def compare_entries(
    at: AtPhase, caller: Looker, platform: PlatformDep, a: SubmissionQuery, b: SubmissionQuery
) -> ComparisonAnswer:
    """Return the differences by the active ground truth and metric, and their significance."""
    with platform.database.reading() as session:
        phase_id, viewer = at.find(session).id, viewer_for(session, caller)
        both = (known_submission(session, viewer, a), known_submission(session, viewer, b))
    return comparison_answer(compare(platform, phase_id, both, viewer))
