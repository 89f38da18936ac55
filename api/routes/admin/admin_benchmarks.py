"""Routes for administrators: create and change benchmarks and their phases.

**Conventions.** The audit log keeps the reason of every change. A job makes a ground truth. The first ground truth of a
phase becomes active when it is ready, and later ones when a re-score is activated.
"""

from fastapi import APIRouter, Request, Response
from sqlalchemy.orm import Session

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep
from api.etags import require_match, set_head
from api.schemas.base import IdPath
from api.schemas.benchmarks import BenchmarkChange, BenchmarkDetail, CreatedBenchmark, NewBenchmarkBody, PhaseDetail
from api.schemas.phase_bodies import AddedPhaseBody, BenchmarkName, NewPhaseBody, PhaseChange
from api.views.benchmarks import benchmark_detail, benchmark_items, phase_detail
from api.visible import benchmark_of, dataset_of, phase_of
from services.domain.benchmarks.phases.phases import (
    change_benchmark_columns,
    change_phase,
    create_benchmark,
    create_phase,
    default_phases,
    lock_phase,
)
from services.runtime.orm import Benchmark, Phase

router = APIRouter(prefix="/admin", tags=["benchmarks"])


@router.post(
    "/benchmarks", name="create_benchmark", summary="Create a benchmark", status_code=201, responses=refusals(404, 409)
)
def create(
    body: NewBenchmarkBody, caller: Administrator, platform: PlatformDep, response: Response
) -> CreatedBenchmark:
    """Create a benchmark of a dataset version, in the given phases (default: `val` and `test`)."""
    with platform.database.transaction() as session:
        benchmark = create_benchmark(session, body.asked(caller.user_id))
        phases = _phases(session, benchmark, body)
        facts = {"name": benchmark.name, "dataset": body.dataset, "phases": [phase.name for phase in phases]}
        audit.record_admin_act(session, caller, "benchmark.create", benchmark.id, body.reason, facts)
        shown = dict(benchmark_items(session, [benchmark])[0])
        details = [phase_detail(session, phase) for phase in phases]
    response.headers["Location"] = f"/api/v1/benchmarks/{benchmark.name}"
    return CreatedBenchmark(**shown | {"phases": details})


@router.patch(
    "/benchmarks/{benchmark_name}", summary="Change a benchmark's description or visibility", responses=refusals(404)
)
def change_benchmark(
    benchmark_name: BenchmarkName, body: BenchmarkChange, caller: Administrator, platform: PlatformDep
) -> BenchmarkDetail:
    with platform.database.transaction() as session:
        benchmark = benchmark_of(session, caller, benchmark_name)
        changes = body.columns()
        change_benchmark_columns(session, benchmark, changes)
        audit.record_admin_act(session, caller, "benchmark.change", benchmark.id, body.reason, changes)
        return benchmark_detail(session, benchmark)


@router.post(
    "/benchmarks/{benchmark_name}/phases",
    name="create_phase",
    summary="Add a phase to a benchmark",
    status_code=201,
    responses=refusals(404, 409),
)
def add_phase(
    benchmark_name: BenchmarkName,
    body: AddedPhaseBody,
    caller: Administrator,
    platform: PlatformDep,
    response: Response,
) -> PhaseDetail:
    """Add the phase; `findings` contain warnings if its labels are not as hidden as intended."""
    with platform.database.transaction() as session:
        benchmark = benchmark_of(session, caller, benchmark_name)
        phase = _phase(session, benchmark, body, body.dataset)
        facts = {"benchmark": benchmark.name, "name": phase.name, "dataset": body.dataset}
        audit.record_admin_act(session, caller, "phase.create", phase.id, body.reason, facts)
        shown = phase_detail(session, phase)
    return set_head(response, shown, tag=phase.revision, location=f"/api/v1/phases/{phase.id}")


@router.get("/phases/{phase_id}", summary="Show a phase with its findings", responses=refusals(404))
def show_admin_phase(
    phase_id: IdPath, _caller: Administrator, platform: PlatformDep, response: Response
) -> PhaseDetail:
    """Return the phase with its findings: for example, labels may have become public since it was created."""
    with platform.database.reading() as session:
        phase = phase_of(session, phase_id)
        return set_head(response, phase_detail(session, phase), tag=phase.revision)


@router.patch(
    "/phases/{phase_id}",
    name="change_phase",
    summary="Change a phase's dates and limits",
    responses=refusals(404, 409, 412, 428),
)
def change(
    phase_id: IdPath,
    body: PhaseChange,
    caller: Administrator,
    platform: PlatformDep,
    request: Request,
    response: Response,
) -> PhaseDetail:
    """Change a phase. The evaluated data can change only before there is a ground truth."""
    with platform.database.transaction() as session:
        phase = lock_phase(session, phase_of(session, phase_id).id)
        require_match(request, phase.revision)
        changes = body.columns()
        if body.dataset is not None:
            changes["dataset_id"] = dataset_of(session, body.dataset).id
        facts = {name: {"from": getattr(phase, name), "to": value} for name, value in changes.items()}
        phase = change_phase(session, phase.id, changes)
        audit.record_admin_act(session, caller, "phase.change", phase.id, body.reason, facts)
        shown = phase_detail(session, phase)
    return set_head(response, shown, tag=phase.revision)


def _phases(session: Session, benchmark: Benchmark, body: NewBenchmarkBody) -> list[Phase]:
    if body.phases is not None:
        return [_phase(session, benchmark, phase, phase.dataset or body.dataset) for phase in body.phases]
    dataset = dataset_of(session, body.dataset)
    return [create_phase(session, benchmark, dataset, new_phase) for new_phase in default_phases(session, dataset)]


def _phase(session: Session, benchmark: Benchmark, body: NewPhaseBody, dataset: str) -> Phase:
    return create_phase(session, benchmark, dataset_of(session, dataset), body.asked())
