"""Benchmarks as administrators make and run them: `/admin/benchmarks` and one benchmark with its phases."""

from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import HTMLResponse
from sqlalchemy import func, select
from sqlalchemy.orm import Session

from api.deps import Administrator, PlatformDep
from api.schemas.phase_bodies import BenchmarkName
from api.views.benchmarks import benchmark_items, phase_detail, phases_of
from api.visible import benchmark_of
from services.domain.benchmarks.alarms.alarms import open_alarms
from services.runtime.orm import Benchmark, Dataset
from web.rendering import page

router = APIRouter()
SHOWN = 200


@router.get("/admin/benchmarks")
def benchmarks(request: Request, caller: Administrator, platform: PlatformDep) -> HTMLResponse:
    with platform.database.reading() as session:
        rows = session.scalars(select(Benchmark).order_by(Benchmark.id.desc()).limit(SHOWN)).all()
        values: dict[str, Any] = {"benchmarks": benchmark_items(session, rows), "datasets": versions(session)}
    return page(request, caller, "admin/benchmarks.html", **values)


@router.get("/admin/benchmarks/{benchmark_name}")
def benchmark(
    benchmark_name: BenchmarkName, request: Request, caller: Administrator, platform: PlatformDep
) -> HTMLResponse:
    with platform.database.reading() as session:
        row = benchmark_of(session, caller, benchmark_name)
        phases = phases_of(session, row)
        values: dict[str, Any] = {
            "benchmark": row,
            "phases": [(phase_detail(session, phase), _alarms(session, phase.id)) for phase in phases],
            "datasets": versions(session),
        }
    return page(request, caller, "admin/benchmark.html", **values)


def versions(session: Session) -> list[str]:
    """Return the names of the versions of the dataset, the newest first."""
    return list(session.scalars(select(Dataset.name).order_by(Dataset.id.desc()).limit(SHOWN)))


def _alarms(session: Session, phase_id: str) -> int:
    return session.scalar(select(func.count()).select_from(open_alarms(phase_id).subquery())) or 0
