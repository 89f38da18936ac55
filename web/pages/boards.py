"""The page of a phase's leaderboard, now or as of a moment of its history, with rank confidence."""

from typing import Annotated

from fastapi import APIRouter, Depends, Query, Request
from fastapi.responses import HTMLResponse

from api.deps import Looker, PlatformDep
from api.routes.benchmarks import PhasePath
from api.schemas.leaderboard import AsOfQuery, EntriesQuery, TrackQuery
from api.schemas.phase_bodies import ns_of
from api.views.benchmarks import phase_item, phases_of
from api.views.boards import history_answer
from api.views.results import viewer_for
from services.domain.benchmarks.boards.entries import TRACKS, BoardQuery
from services.domain.benchmarks.boards.history import tracks_with_rows
from services.runtime.orm import Benchmark
from web.boards.rows import Sort, shown_board, timeline
from web.rendering import page

router = APIRouter()
SortQuery = Annotated[Sort, Query(description="column to sort by; ranks do not change")]


class BoardPageSelection:
    """Which board, in which order."""

    def __init__(
        self,
        track: TrackQuery = "all",
        as_of: AsOfQuery = None,
        entries: EntriesQuery = "best",
        sort: SortQuery = "rank",
    ) -> None:
        self.query = BoardQuery(track, None if as_of is None else ns_of(as_of), entries)
        self.sort: Sort = sort


Asked = Annotated[BoardPageSelection, Depends(BoardPageSelection)]


@router.get("/benchmarks/{benchmark_name}/{phase_name}")
def show_board(
    request: Request,
    caller: Looker,
    platform: PlatformDep,
    at: Annotated[PhasePath, Depends(PhasePath)],
    asked: Asked,
) -> HTMLResponse:
    with platform.database.reading() as session:
        phase = at.find(session)
        viewer, shown_phase = viewer_for(session, caller), phase_item(session, phase)
        row = session.get_one(Benchmark, phase.benchmark_id)
        phases = phases_of(session, row)
        changes = history_answer(session, phase, asked.query.track).changes
        tracks = tracks_with_rows(session, phase)
    shown = shown_board(platform, phase.id, viewer, asked.query, asked.sort)
    return page(
        request,
        caller,
        "boards/board.html",
        benchmark=row,
        phases=phases,
        phase=shown_phase,
        board=shown,
        tracks=[track for track in TRACKS if track in tracks or track in ("all", asked.query.track)],
        timeline=timeline(shown, changes),
    )
