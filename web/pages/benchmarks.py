"""The pages of benchmarks: their tasks, dates, rules and leaders."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Request
from fastapi.responses import HTMLResponse
from sqlalchemy.orm import Session

from api.deps import Looker, PlatformDep
from api.paging import PageDep
from api.paging import page as page_of
from api.routes.benchmarks import PhasePath
from api.schemas.benchmarks import PhaseItem
from api.schemas.phase_bodies import BenchmarkName, MetricName
from api.views.benchmarks import benchmark_items, metric_item, phase_item, phases_of
from api.views.results import viewer_for
from api.visible import benchmark_of, benchmarks_of
from services.domain.benchmarks.phases.open_frames import open_truth_of
from services.domain.benchmarks.visibility import Viewer
from services.runtime.orm import Benchmark, Phase
from services.runtime.platform import Platform
from stone_base.label_grid import PAPER
from web.boards.open_example import chosen_frame
from web.boards.rows import ShownBoard, shortened, shown_board
from web.markdown import html_of
from web.rendering import page

router = APIRouter()
AtPhase = Annotated[PhasePath, Depends(PhasePath)]
FIRST = 3
"""Number of benchmarks of a list that show leaders, because each requires its board."""


@dataclass(frozen=True)
class ShownPhase:
    """A phase with the head of its board; `passed` is the elapsed share of its time, None without both ends."""

    item: PhaseItem
    board: ShownBoard
    passed: float | None


@router.get("/benchmarks")
def list_benchmarks(request: Request, caller: Looker, platform: PlatformDep, query: PageDep) -> HTMLResponse:
    with platform.database.reading() as session:
        rows = page_of(session, benchmarks_of(caller), Benchmark.id.desc(), query)
        items = benchmark_items(session, rows.rows)
        phases = {row.name: _phases(session, row) for row in rows.rows}
        viewer = viewer_for(session, caller)
    leaders = {item.name: _leaders(platform, phases[item.name], viewer) for item in items[:FIRST]}
    known: dict[str, Any] = {"benchmarks": items, "phases": phases, "leaders": leaders, "cursor": rows.next}
    return page(request, caller, "boards/benchmarks.html", **known)


@router.get("/benchmarks/{benchmark_name}")
def show_benchmark(
    request: Request, benchmark_name: BenchmarkName, caller: Looker, platform: PlatformDep
) -> HTMLResponse:
    with platform.database.reading() as session:
        row = benchmark_of(session, caller, benchmark_name)
        phases, viewer = _phases(session, row), viewer_for(session, caller)
        first = min(phases, key=lambda phase: phase.is_hidden, default=None)
        truth = open_truth_of(session, session.get_one(Phase, first.id)) if first else None
    known: dict[str, Any] = {
        "benchmark": row,
        "phases": [
            ShownPhase(phase, shortened(shown_board(platform, phase.id, viewer)), _passed(phase)) for phase in phases
        ],
        "first": first,
        "example": chosen_frame(platform, truth),
        "grid": first.grid if first else PAPER,
    }
    return page(request, caller, "boards/benchmark.html", **known)


@router.get("/benchmarks/{benchmark_name}/{phase_name}/metrics/{metric}")
def show_definition(
    request: Request, caller: Looker, platform: PlatformDep, at: AtPhase, metric: MetricName
) -> HTMLResponse:
    with platform.database.reading() as session:
        phase = at.find(session)
        item = phase_item(session, phase)
        title = session.get_one(Benchmark, phase.benchmark_id).title or at.benchmark
        definition = metric_item(session, phase, metric)
    known: dict[str, Any] = {
        "phase": item,
        "benchmark_title": title,
        "metric": definition,
        "definition": html_of(definition.definition),
    }
    return page(request, caller, "boards/metric.html", **known)


def _phases(session: Session, row: Benchmark) -> list[PhaseItem]:
    return [phase_item(session, phase) for phase in phases_of(session, row)]


def _leaders(platform: Platform, phases: Iterable[PhaseItem], viewer: Viewer) -> ShownBoard | None:
    """Return the head of the board of the running phase, else of the first; None without a phase."""
    ordered = sorted(phases, key=lambda phase: phase.standing != "open")
    return shortened(shown_board(platform, ordered[0].id, viewer), FIRST) if ordered else None


def _passed(item: PhaseItem) -> float | None:
    if item.opens_at is None or item.closes_at is None:
        return None
    length_s = (item.closes_at - item.opens_at).total_seconds()
    return min(max((datetime.now(UTC) - item.opens_at).total_seconds() / length_s, 0.0), 1.0)
