"""Ground truths of a phase: started, built by a job, the first one activated.

**Conventions.** A ground truth takes part and mask from its phase, and its frames from a dataset version, usually the
phase's own. Once a phase has entries, a new ground truth must contain exactly the frames of the active one; otherwise
the entries could not be scored again. Adding a ground truth locks the phase.
"""

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases import evaluation_versions
from services.domain.benchmarks.phases.phases import lock_phase, refuse_empty
from services.domain.benchmarks.submissions.scoring_jobs import truth_spec
from services.domain.benchmarks.teams.teams import BINDING
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import TERMINAL, Context
from services.runtime.orm import (
    Activation,
    Blob,
    Dataset,
    DatasetPart,
    GroundTruthRow,
    Job,
    Phase,
    SubmissionRow,
    new_id,
)
from services.runtime.platform import Platform
from services.runtime.store.packs import read_index
from stone.errors import Refused
from stone.scoring.metric import METRIC_VERSION
from stone_base.label_grid import recorded_grid, require_one_geometry

LABELS = "gts/"


@dataclass(frozen=True)
class TruthFrameComparison:
    """The difference between a version's frames and the frames of the ground truth that was active."""

    truth_id: str
    dataset_id: str
    missing: int
    extra: int


def compare_frames(platform: Platform, phase_id: str, dataset: Dataset) -> TruthFrameComparison | None:
    """Return the comparison that `start_truth` needs; None if there is nothing to compare with.

    Reads two indexes from the store: call it outside transactions. Raises `store_unavailable`.
    """
    with platform.database.reading() as session:
        pair = evaluation_versions.active(session, phase_id)
        if pair is None:
            return None
        truth = session.get_one(GroundTruthRow, pair.truth_id)
        keys = [_index_key(session, dataset_id, truth.part) for dataset_id in (truth.dataset_id, dataset.id)]
    before, after = (_tokens(platform, key) if key else frozenset() for key in keys)
    return TruthFrameComparison(truth.id, dataset.id, len(before - after), len(after - before))


def start_truth(
    session: Session, phase: Phase, dataset: Dataset, user_id: str, compared: TruthFrameComparison | None = None
) -> tuple[GroundTruthRow, Job]:
    """Return a new ground truth and the job that builds it.

    `compared` is required if the version differs from the active ground truth's. Raises `empty_part`,
    `truth_in_making`, `other_frames`, `grids_differ`, `truth_changed`, `QueueDrainingError`.
    """
    phase = lock_phase(session, phase.id)
    refuse_empty(session, dataset, phase.part)
    _refuse_second(session, phase)
    _refuse_other_grid(session, phase, dataset)
    _refuse_other_frames(session, phase, dataset, compared)
    last = select(func.coalesce(func.max(GroundTruthRow.number), 0)).where(GroundTruthRow.phase_id == phase.id)
    truth = GroundTruthRow(
        id=new_id(), phase_id=phase.id, number=session.scalars(last).one() + 1, dataset_id=dataset.id
    )
    truth.part, truth.mask, truth.created_by = phase.part, phase.mask, user_id
    job = enqueue(session, truth_spec(truth), Context(user_id))
    truth.job_id = job.id
    session.add(truth)
    session.flush()
    return truth, job


def first_activation(session: Session, truth: GroundTruthRow) -> Activation | None:
    """Activate a ready ground truth with the default metric; return None if another is already active."""
    phase = lock_phase(session, truth.phase_id)
    if evaluation_versions.active(session, phase.id) is not None:
        return None
    row = Activation(phase_id=phase.id, truth_id=truth.id, metric=METRIC_VERSION, activated_by=truth.created_by)
    session.add(row)
    session.flush()
    return row


def _refuse_second(session: Session, phase: Phase) -> None:
    """Refuse a second ground truth under construction: two would race to be activated first."""
    made = select(GroundTruthRow.number, Job.id).join(Job, Job.id == GroundTruthRow.job_id)
    under_way = made.where(
        GroundTruthRow.phase_id == phase.id, GroundTruthRow.ready_ns.is_(None), Job.state.not_in(TERMINAL)
    )
    for number, job_id in session.execute(under_way.limit(1)):
        raise Refused(
            "truth_in_making", f"job {job_id} is creating ground truth {number}; wait for the job or cancel it first"
        )


def _refuse_other_frames(
    session: Session, phase: Phase, dataset: Dataset, compared: TruthFrameComparison | None
) -> None:
    pair = evaluation_versions.active(session, phase.id)
    if pair is None or session.get_one(GroundTruthRow, pair.truth_id).dataset_id == dataset.id:
        return
    if not _has_entries(session, phase):
        return
    if compared is None or (compared.truth_id, compared.dataset_id) != (pair.truth_id, dataset.id):
        raise Refused(
            "truth_changed",
            f"the active ground truth of phase {phase.name!r} changed in the meantime; reload and retry",
        )
    if compared.missing or compared.extra:
        raise Refused(
            "other_frames",
            f"{compared.missing} frame(s) of the active ground truth are not in this version and {compared.extra} are "
            "new. The entries could not be scored again, so create a new phase from this version",
        )


def _refuse_other_grid(session: Session, phase: Phase, dataset: Dataset) -> None:
    """Refuse a grid that differs from the phase's first ground truth: submissions have its shape."""
    first = select(Dataset).join(GroundTruthRow, GroundTruthRow.dataset_id == Dataset.id)
    first = first.where(GroundTruthRow.phase_id == phase.id).order_by(GroundTruthRow.number).limit(1)
    standing = session.scalar(first)
    if standing is not None:
        require_one_geometry(recorded_grid(standing.grid), recorded_grid(dataset.grid))


def _has_entries(session: Session, phase: Phase) -> bool:
    """Return whether the phase has entries, or unfinished submissions, which every evaluation version must score."""
    entries = select(SubmissionRow.id).where(SubmissionRow.phase_id == phase.id, SubmissionRow.kind != "validation")
    standing = entries.where(SubmissionRow.state.in_(BINDING), SubmissionRow.withdrawn_ns.is_(None))
    return session.scalar(standing.limit(1)) is not None


def _index_key(session: Session, dataset_id: str, part: str) -> str | None:
    """Return the store key of the part's index, or None if the version lacks the part."""
    joined = select(Blob.object_key).join(DatasetPart, DatasetPart.index_sha256 == Blob.sha256)
    return session.scalar(joined.where(DatasetPart.dataset_id == dataset_id, DatasetPart.part == part))


def _tokens(platform: Platform, index_key: str) -> frozenset[str]:
    """Return the tokens of the frames whose labels an index lists."""
    files = read_index(b"".join(platform.store.read(index_key)))
    return frozenset(name.split("/")[2] for name in files.names if name.startswith(LABELS))
