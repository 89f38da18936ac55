"""The pages of a phase beside its board: its data and its rules.

**Conventions.** Whoever may look at the benchmark sees them; bytes are for whoever is signed in.
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
    """What to download: manifest, inputs, labels to train on, starter code, baselines."""
    with platform.database.reading() as session:
        phase = at.find(session)
        known = _head(session, phase) | {"data": phase_downloads(session, phase)}
    known["predict_line"] = predict_line(at.benchmark, at.phase)
    return page(request, caller, "boards/data.html", **known)


@router.get("/rules")
def show_rules(request: Request, caller: Looker, platform: PlatformDep, at: AtPhase) -> HTMLResponse:
    """Dates, quotas, what a prediction may use, who sees what."""
    with platform.database.reading() as session:
        known = _head(session, at.find(session))
    return page(request, caller, "boards/rules.html", **known)


def _head(session: Session, phase: Phase) -> dict[str, Any]:
    """What both pages begin with: the benchmark, its phases, and this one."""
    row = session.get_one(Benchmark, phase.benchmark_id)
    return {"benchmark": row, "phases": phases_of(session, row), "phase": phase_item(session, phase)}
