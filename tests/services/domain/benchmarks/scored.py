"""A phase with ground truths, teams and scored entries, as rows only: what the stages write, without their work.

**Conventions.** Every file is one and the same small blob. Ratios and cells are what a test says they are.
"""

from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

from sqlalchemy.orm import Session

from services.runtime.orm import (
    Activation,
    Benchmark,
    Dataset,
    GroundTruthRow,
    Phase,
    Score,
    SubmissionRow,
    Team,
    User,
    new_id,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from stone.scoring.metric import METRIC_VERSION, RATIOS

CELLS = [[[1000, 20, 30, 40], [5, 600, 7, 8], [9, 10, 700, 11], [12, 13, 14, 800]]] * 3


@dataclass(frozen=True)
class Place:
    """Where entries are laid down: the phase, the first ground truth, and the blob that every file is."""

    platform: Platform
    user: User
    phase: Phase
    truth_id: str
    dataset_id: str
    blob_sha256: str


@dataclass(frozen=True)
class Laid:
    """How an entry scored: mIoU (every other ratio is the same), its counts, and what else is to stand in the row."""

    miou: float | None = 0.5
    cells: dict[str, Any] = field(default_factory=lambda: {"forest": CELLS})
    columns: dict[str, Any] = field(default_factory=dict)


def phase_of_rows(platform: Platform, activated_ns: int | None = None) -> Place:
    """An open phase whose board shows its first ground truth, since then or from now on."""
    path = platform.settings.root / "file"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"what is kept")
    with platform.database.transaction() as session:
        user = User(name=f"admin-{new_id()[-8:]}", role="administrator")
        session.add(user)
        blob = blobs.keep(session, platform.store, path)
        session.flush()
        dataset = Dataset(name=f"v-{new_id()[-8:]}", code_version="1", manifest_sha256=blob.sha256, manifest_bytes=1)
        benchmark = Benchmark(name=f"b-{new_id()[-8:]}", created_by=user.id)
        dataset.created_by = user.id
        session.add_all([dataset, benchmark])
        session.flush()
        phase = Phase(benchmark_id=benchmark.id, name="val", dataset_id=dataset.id, part="val", is_hidden=False)
        session.add(phase)
        session.flush()
        truth = _truth(session, phase, user.id, 1)
        _activate(session, truth, user.id, activated_ns or now_ns())
        return Place(platform, user, phase, truth.id, dataset.id, blob.sha256)


def another_truth(place: Place, is_ready: bool = True) -> str:
    """The id of a further ground truth of the phase."""
    with place.platform.database.transaction() as session:
        number = session.query(GroundTruthRow).filter_by(phase_id=place.phase.id).count() + 1
        return _truth(session, place.phase, place.user.id, number, is_ready).id


def team(place: Place, name: str = "") -> str:
    with place.platform.database.transaction() as session:
        row = Team(name=name or f"team-{new_id()[-8:]}")
        session.add(row)
        session.flush()
        return row.id


def entry(place: Place, team_id: str, **columns: Any) -> str:
    """The id of an entry that was scored, as yet without any score."""
    with place.platform.database.transaction() as session:
        row = SubmissionRow(phase_id=place.phase.id, team_id=team_id, user_id=place.user.id, method="Net", modality="L")
        row.declared_sha256, row.size_bytes, row.state = "0" * 64, 1, "scored"
        row.blob_sha256, row.finalized_ns, row.settled_ns = place.blob_sha256, now_ns(), now_ns()
        for name, value in columns.items():
            setattr(row, name, value)
        session.add(row)
        session.flush()
        return row.id


def score(session: Session, place: Place, submission_id: str, laid: Laid) -> Score:
    """A score of the entry, by the first version unless `laid` says otherwise, in the caller's transaction."""
    content = sha256(repr(sorted(laid.cells.items())).encode()).hexdigest()
    row = Score(submission_id=submission_id, truth_id=place.truth_id, metric=METRIC_VERSION)
    row.signature, row.content_sha256 = "signature", content
    row.record = {"cells": laid.cells}
    row.confusions_sha256 = row.spectra_sha256 = place.blob_sha256
    for name in RATIOS:
        setattr(row, name, laid.miou)
    for name, value in laid.columns.items():
        setattr(row, name, value)
    session.add(row)
    session.flush()
    return row


def scored_entry(place: Place, team_id: str, miou: float | None = 0.5, **columns: Any) -> str:
    """The id of an entry with its score by the evaluation version of the first ground truth."""
    submission_id = entry(place, team_id, **columns)
    scored(place, submission_id, miou)
    return submission_id


def scored(place: Place, submission_id: str, miou: float | None, truth_id: str = "") -> None:
    with place.platform.database.transaction() as session:
        score(session, place, submission_id, Laid(miou, columns={"truth_id": truth_id or place.truth_id}))


def _truth(session: Session, phase: Phase, user_id: str, number: int, is_ready: bool = True) -> GroundTruthRow:
    row = GroundTruthRow(phase_id=phase.id, number=number, dataset_id=phase.dataset_id, part="val", mask="all")
    row.created_by, row.frames, row.ready_ns = user_id, 2000, now_ns() if is_ready else None
    session.add(row)
    session.flush()
    return row


def _activate(session: Session, truth: GroundTruthRow, user_id: str, activated_ns: int) -> None:
    row = Activation(phase_id=truth.phase_id, truth_id=truth.id, metric=METRIC_VERSION, activated_by=user_id)
    row.activated_ns = activated_ns
    session.add(row)
