"""The pages of a phase beside its board: its data and its rules.

**Conventions.** They are visible to all viewers of the benchmark; downloads require an account.
"""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse
from sqlalchemy.orm import Session

from api.deps import Looker, PlatformDep
from api.routes.benchmarks import PhasePath
from api.views.benchmarks import phase_item, phases_of
from services.runtime.orm import Benchmark, Phase
from web.boards.phase_data import phase_downloads
from web.boards.submission_steps import predict_line
from web.rendering import page

router = APIRouter(prefix="/benchmarks/{benchmark_name}/{phase_name}")
AtPhase = Annotated[PhasePath, Depends(PhasePath)]


@router.get("/data")
def show_data(request: Request, caller: Looker, platform: PlatformDep, at: AtPhase) -> HTMLResponse:
    """Show the downloads: manifest, inputs, training labels, starter code, baselines."""
    with platform.database.reading() as session:
        phase = at.find(session)
        known = _head(session, phase) | {"data": phase_downloads(session, phase)}
    known["predict_line"] = predict_line(at.benchmark, at.phase)
    return page(request, caller, "boards/data.html", **known)


@router.get("/rules")
def show_rules(request: Request, caller: Looker, platform: PlatformDep, at: AtPhase) -> HTMLResponse:
    """Show dates, quotas, allowed inputs and visibility."""
    with platform.database.reading() as session:
        known = _head(session, at.find(session))
    return page(request, caller, "boards/rules.html", **known)


def _head(session: Session, phase: Phase) -> dict[str, Any]:
    """Return the common values of both pages: the benchmark, its phases, and this phase."""
    row = session.get_one(Benchmark, phase.benchmark_id)
    return {"benchmark": row, "phases": phases_of(session, row), "phase": phase_item(session, phase)}
