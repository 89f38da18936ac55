"""The page that compares two entries of a phase: which is better, and whether that is more than chance."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import RedirectResponse

from api.deps import Looker, PlatformDep
from api.routes.benchmarks import PhasePath
from api.schemas.base import IdQuery, IdText
from api.views.boards import comparison_answer
from api.views.results import known_submission, viewer_for
from services.domain.benchmarks.boards.comparison import compare
from services.domain.benchmarks.boards.entries import BoardQuery
from services.runtime.orm import Benchmark, SubmissionRow
from web.boards.comparison import Names, compared
from web.boards.rows import shown_board
from web.rendering import page

router = APIRouter()
AtPhase = Annotated[PhasePath, Depends(PhasePath)]


class EntryChoice:
    """The two entries: named `a` and `b`, or picked from a board, the first as `a`."""

    def __init__(
        self, a: IdQuery = None, b: IdQuery = None, entry: Annotated[list[IdText] | None, Query(max_length=2)] = None
    ) -> None:
        self.was_picked = bool(entry)
        self.a, self.b = (*entry, None)[:2] if entry else (a, b)


@router.get("/benchmarks/{benchmark_name}/{phase_name}/compare")
def compare_entries(
    request: Request,
    caller: Looker,
    platform: PlatformDep,
    at: AtPhase,
    picked: Annotated[EntryChoice, Depends(EntryChoice)],
) -> Response:
    path = f"/benchmarks/{at.benchmark}/{at.phase}"
    if picked.was_picked and picked.a and picked.b:
        return RedirectResponse(f"{path}/compare?a={picked.a}&b={picked.b}", 303)
    with platform.database.reading() as session:
        phase = at.find(session)
        title = session.get_one(Benchmark, phase.benchmark_id).title or at.benchmark
        viewer = viewer_for(session, caller)
        chosen = [known_submission(session, viewer, item) if item else None for item in (picked.a, picked.b)]
    board = shown_board(platform, phase.id, viewer, BoardQuery(entries="all"))
    a, b = chosen
    shown = None
    if a is not None and b is not None:
        answer = comparison_answer(compare(platform, phase.id, (a, b), viewer))
        shown = compared(answer, _names(a, b))
    rows = [item.row for group in board.groups for item in group.rows if item.row.submission_id]
    known: dict[str, Any] = {
        "phase": phase,
        "benchmark": at.benchmark,
        "benchmark_title": title,
        "path": path,
        "rows": rows,
        "a": a,
        "b": b,
        "shown": shown,
        "answer": None if shown is None else answer,
    }
    return page(request, caller, "boards/compare.html", **known)


def _names(a: SubmissionRow, b: SubmissionRow) -> Names:
    """Return the names of the methods; equal names get the end of their ids."""
    if a.method != b.method:
        return Names(a.method, b.method)
    return Names(f"{a.method} ({a.id[-4:]})", f"{b.method} ({b.id[-4:]})")
