"""Benchmarks as the API shows them: rows of `services.runtime.orm.benchmarks` become bodies.

**Conventions.** A phase's ground truth is shown by its number and hashes only.
"""

from collections.abc import Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.errors import NotFoundError
from api.schemas.base import instant
from api.schemas.benchmarks import (
    ActiveItem,
    BenchmarkDetail,
    BenchmarkItem,
    MetricItem,
    PhaseDetail,
    PhaseFinding,
    PhaseItem,
    SignatureItem,
)
from api.schemas.grids import GridItem
from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.phases.findings import findings_of
from services.domain.benchmarks.phases.phases import phase_status
from services.domain.benchmarks.visibility import policy_sentences
from services.domain.datasets.queries import dataset_quality
from services.runtime.orm import Benchmark, Dataset, GroundTruthRow, Phase
from services.runtime.orm.base import now_ns
from stone.scoring.metric import METRICS, Metric


def benchmark_items(session: Session, rows: Sequence[Benchmark]) -> list[BenchmarkItem]:
    """Return benchmarks as a list shows them; one statement reads the phases of all."""
    of_these = select(Phase.benchmark_id, Phase.name).where(Phase.benchmark_id.in_([row.id for row in rows]))
    names: dict[str, list[str]] = {}
    for benchmark_id, name in session.execute(of_these.order_by(Phase.name)):
        names.setdefault(benchmark_id, []).append(name)
    return [BenchmarkItem.of(row, phases=names.get(row.id, [])) for row in rows]


def benchmark_detail(session: Session, row: Benchmark) -> BenchmarkDetail:
    """Return a benchmark with its phases, by name."""
    return BenchmarkDetail.of(row, phases=[phase_item(session, phase) for phase in phases_of(session, row)])


def phases_of(session: Session, benchmark: Benchmark) -> Sequence[Phase]:
    return session.scalars(select(Phase).where(Phase.benchmark_id == benchmark.id).order_by(Phase.name)).all()


def phase_detail(session: Session, phase: Phase) -> PhaseDetail:
    """Return a phase for an administrator."""
    findings = [PhaseFinding.of(finding, severity="warning") for finding in findings_of(session, phase)]
    return PhaseDetail(**dict(phase_item(session, phase)), findings=findings)


def phase_item(session: Session, phase: Phase) -> PhaseItem:
    """Return a phase for any reader."""
    at_ns, dataset = now_ns(), session.get_one(Dataset, phase.dataset_id)
    return PhaseItem.of(
        phase,
        **dataset_quality(session, phase.dataset_id).as_record(),
        benchmark=session.get_one(Benchmark, phase.benchmark_id).name,
        dataset=dataset.name,
        grid=GridItem.recorded(dataset.grid),
        standing=phase_status(phase, at_ns),
        window_s=phase.window_ns // 10**9,
        active=_active(session, phase),
        visibility=list(policy_sentences(phase, at_ns)),
    )


def metric_item(session: Session, phase: Phase, version: str) -> MetricItem:
    """Return a version of the metric, and whether the phase is scored by it. Raises `NotFoundError`."""
    shown, pair = known_metric(version), evaluation_versions.active(session, phase.id)
    is_active = pair is not None and pair.metric == version
    return MetricItem.of(shown, is_active=is_active)


def known_metric(version: str) -> Metric:
    """Return the metric of this version. Raises `NotFoundError`."""
    if version not in METRICS:
        raise NotFoundError("metric", version)
    return METRICS[version]


def _active(session: Session, phase: Phase) -> ActiveItem | None:
    activation = evaluation_versions.in_force(session, phase.id)
    if activation is None:
        return None
    truth = session.get_one(GroundTruthRow, activation.truth_id)
    return ActiveItem(
        ground_truth=truth.number,
        metric=activation.metric,
        dataset=session.get_one(Dataset, truth.dataset_id).name,
        frames=truth.frames,
        manifest_sha256=truth.manifest_sha256 or "",
        activated_at=instant(activation.activated_ns),
        signature=SignatureItem(metric=activation.metric, ground_truth=truth.sha256, mask=truth.mask),
    )
