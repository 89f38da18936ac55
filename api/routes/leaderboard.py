"""The board of a phase, and two of its entries side by side.

**Conventions.** Read by whoever is signed in, of a public benchmark by anybody; what each may see is decided where
rows are read (`services/runtime/benchmarks/visibility.py`). The ETag is of the very bytes, so a board that did not
change is not sent again.
"""

from typing import Annotated

from fastapi import APIRouter, Depends, Request, Response

from api.answers import Responses, refusals
from api.board_views import JSON_TYPE, board_response, comparison_answer, history_answer
from api.callers import Looker
from api.deps import PlatformDep
from api.result_views import known_submission, viewer_for
from api.routes.benchmarks import AT, AtPhase
from api.schemas.benchmark_bodies import ns_of
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
from services.runtime.benchmarks.board import board
from services.runtime.benchmarks.board_entries import BoardQuery
from services.runtime.benchmarks.board_tables import MEDIA_TYPES
from services.runtime.benchmarks.comparing import compare

router = APIRouter(prefix=AT, tags=["benchmarks"])
BINARY = {"schema": {"type": "string", "format": "binary"}}
FORMS = {
    JSON_TYPE: {"schema": {"$ref": "#/components/schemas/LeaderboardAnswer"}},
    **{media_type.partition(";")[0]: BINARY for media_type in MEDIA_TYPES.values()},
}
BOARD: Responses = {200: {"content": FORMS}, 304: {"description": "The caller has it already"}, **refusals(404)}


class BoardAsked:
    """Which board, in which form."""

    def __init__(
        self,
        track: TrackQuery = "all",
        as_of: AsOfQuery = None,
        entries: EntriesQuery = "best",
        form: FormQuery = "json",
    ) -> None:
        self.query = BoardQuery(track, None if as_of is None else ns_of(as_of), entries)
        self.form = form


Asked = Annotated[BoardAsked, Depends(BoardAsked)]


@router.get("/leaderboard", response_model=LeaderboardAnswer, responses=BOARD)
def show_leaderboard(at: AtPhase, asked: Asked, caller: Looker, platform: PlatformDep, request: Request) -> Response:
    """The board: ranks with their intervals and ties, baselines and reported results beside them, now or as of then."""
    with platform.database.reading() as session:
        phase_id, viewer = at.find(session).id, viewer_for(session, caller)
    return board_response(request, board(platform, phase_id, asked.query, viewer), viewer, asked.form)


@router.get("/leaderboard/history", responses=refusals(404))
def show_history(at: AtPhase, platform: PlatformDep, track: TrackQuery = "all") -> HistoryAnswer:
    """When the board changed, and the best mIoU since each change."""
    with platform.database.reading() as session:
        return history_answer(session, at.find(session), track)


@router.get("/compare", responses=refusals(404, 409))
def compare_entries(
    at: AtPhase, caller: Looker, platform: PlatformDep, a: SubmissionQuery, b: SubmissionQuery
) -> ComparisonAnswer:
    """How two entries differ by the pair in force, and whether that is more than chance."""
    with platform.database.reading() as session:
        phase_id, viewer = at.find(session).id, viewer_for(session, caller)
        both = (known_submission(session, viewer, a), known_submission(session, viewer, b))
    return comparison_answer(compare(platform, phase_id, both, viewer))
