"""Entries with true records and true spectra, from counts that a test makes up: no grid, no zip, no job.

**Conventions.** The ground truth is of three sequences of 450 frames. All entries meet the same ground, hard in places;
`errors` is about what share of its voxels an entry gets wrong. Equal arguments, equal counts.
"""

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.submissions.score_rows import NewScore, write_score
from services.domain.benchmarks.visibility import Viewer
from services.eval.spectra_file import spectra_npz
from services.runtime.orm import Activation, GroundTruthRow, Phase, Score, SubmissionRow, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from stone.scoring.frame_counts import ColumnCounts
from stone.scoring.metric import METRIC_VERSION, RATIOS
from stone.scoring.score_record import SequenceFacts, SubmissionCounts, record_of
from stone_files.npz import npz_bytes
from tests.services.domain.benchmarks.scored import Place, entry, phase_of_rows, team

SEQUENCES = (
    SequenceFacts("one", 450, "forest", "day"),
    SequenceFacts("two", 450, "forest", "night"),
    SequenceFacts("three", 450, "lake", "day"),
)
FRAMES = sum(one.frames for one in SEQUENCES)
ADMINISTRATOR = Viewer(is_administrator=True)
HOUR_NS = 3600 * 10**9

Counts = NDArray[np.int32]


@dataclass(frozen=True)
class Made:
    """How an entry scores: `seed` tells its errors apart from another's, `without` empties a class altogether.

    `total` are totals to be written instead of what the counts say. `is_withdrawn` writes what was kept while intervals
    were those of resampled blocks.
    """

    errors: float = 0.3
    seed: int = 0
    without: int | None = None
    total: tuple[tuple[str, float], ...] = ()
    is_withdrawn: bool = False


@dataclass(frozen=True)
class Scene:
    """A phase whose board can be filled."""

    place: Place

    @property
    def platform(self) -> Platform:
        return self.place.platform

    @property
    def phase_id(self) -> str:
        return self.place.phase.id

    @property
    def evaluation_version(self) -> EvaluationVersion:
        return EvaluationVersion(self.place.truth_id, METRIC_VERSION)

    def team(self, name: str = "") -> str:
        return team(self.place, name)

    def enter(self, team_id: str, made: Made | None = None, **columns: Any) -> str:
        """The id of a scored submission of the team."""
        submission_id = entry(self.place, team_id, **columns)
        if made is not None:
            self.score(submission_id, made)
        return submission_id

    def score(self, submission_id: str, made: Made, evaluation_version: EvaluationVersion | None = None) -> str:
        """The id of the score of the submission by the evaluation version."""
        record, confusions, spectra = computed(made)
        files = (self._stored(confusions), self._stored(spectra))
        new = NewScore(
            submission_id,
            evaluation_version or self.evaluation_version,
            "metric:a|truth:b",
            record,
            files[0],
            files[1],
            "c" * 64,
        )
        with self.platform.database.transaction() as session:
            return write_score(session, new).id

    def change(self, row_id: str, kind: type[Any] = SubmissionRow, /, **columns: Any) -> None:
        with self.platform.database.transaction() as session:
            row = session.get_one(kind, row_id)
            for name, value in columns.items():
                setattr(row, name, value)

    def hide(self, **columns: Any) -> None:
        """Make the truth of the phase hidden, with these columns."""
        self.change(self.phase_id, Phase, is_hidden=True, **columns)

    def end(self) -> None:
        self.hide(closes_ns=now_ns() - 1)

    def another_pair(self, activated_ns: int | None = None) -> EvaluationVersion:
        """Another ground truth of the same frames; in force from this time on, where one is given."""
        with self.platform.database.transaction() as session:
            old = session.get_one(GroundTruthRow, self.place.truth_id)
            number = 1 + session.query(GroundTruthRow).filter_by(phase_id=old.phase_id).count()
            row = GroundTruthRow(phase_id=old.phase_id, number=number, dataset_id=old.dataset_id, part=old.part)
            row.mask = old.mask
            row.facts, row.frames, row.created_by, row.ready_ns = old.facts, old.frames, old.created_by, now_ns()
            row.manifest_sha256 = old.manifest_sha256
            session.add(row)
            session.flush()
            if activated_ns is not None:
                facts = {"phase_id": old.phase_id, "truth_id": row.id, "metric": METRIC_VERSION}
                session.add(Activation(**facts, activated_by=old.created_by, activated_ns=activated_ns))
            return EvaluationVersion(row.id, METRIC_VERSION)

    def score_row(self, submission_id: str) -> Score:
        with self.platform.database.reading() as session:
            return (
                session.query(Score)
                .filter_by(submission_id=submission_id, truth_id=self.evaluation_version.truth_id)
                .one()
            )

    def _stored(self, content: bytes) -> blobs.PreparedBlob:
        path = self.platform.settings.root / f"made-{new_id()}"
        path.write_bytes(content)
        return blobs.prepare(self.platform.store, self.platform.database, path)


def scene(platform: Platform) -> Scene:
    """An open phase with a ground truth in force since long ago, and no entries."""
    place = phase_of_rows(platform, now_ns() - 1000 * HOUR_NS)
    made = Scene(place)
    facts = {"sequences": [vars(one) for one in SEQUENCES]}
    made.change(place.truth_id, GroundTruthRow, facts=facts, frames=FRAMES, sha256="7" * 64)
    made.change(place.truth_id, GroundTruthRow, manifest_sha256=place.blob_sha256)
    return made


def counts(made: Made) -> Counts:
    """Confusions (F, 3, 4, 4)."""
    ground = np.random.default_rng(7)
    hardness = np.repeat(ground.uniform(0.6, 1.4, FRAMES // 9), 9)[:, None, None]
    voxels = ground.integers(50, 400, (FRAMES, 3, 4)) * np.array([10, 1, 1, 1])
    if made.without is not None:
        voxels[..., made.without] = 0
    own = np.random.default_rng(made.seed).normal(1, 0.05, (FRAMES, 1, 1))
    wrong = np.clip(made.errors * hardness * own, 0, 1)
    missed = np.rint(voxels * wrong).astype(np.int32)
    confusion = np.zeros((FRAMES, 3, 4, 4), np.int32)
    for label in range(4):
        confusion[..., label, label] = voxels[..., label] - missed[..., label]
        other = label % 3 + 1 if label else 1
        other = label if other == made.without else other
        confusion[..., label, other] += missed[..., label]
    return confusion


@cache
def computed(made: Made) -> tuple[dict[str, Any], bytes, bytes]:
    """The record of a score, the npz of its counts, the npz of its spectra."""
    confusions = counts(made)
    bev = np.ones((FRAMES, 3, 3), np.int32)
    by_column = ColumnCounts(np.ones((FRAMES, 3, 4), np.int32), np.ones((FRAMES, 3, 4, 4), np.int32))
    counts_of_frames = SubmissionCounts(confusions, bev, SEQUENCES, by_column)
    spectra = counts_of_frames.spectra()
    record = {"code_version": "9.9", **record_of(counts_of_frames, spectra)}
    record["total"] |= dict(made.total)
    if made.is_withdrawn:
        del record["silences"], record["tolerant"], record["columns"]
        del record["extras"]["n_predicted_drivable_ratio"], record["extras"]["clear_drivable_iou"]
        record["intervals"] = {"block": {name: [0.1, 0.2] for name in RATIOS}, "sequence": dict.fromkeys(RATIOS)}
        replicates = {"block": np.zeros((9, 5), np.float32), "sequence": np.zeros((3, 5), np.float32)}
        return record, npz_bytes({"confusions": confusions, "bev": bev}), npz_bytes(replicates)
    return record, npz_bytes({"confusions": confusions, "bev": bev}), spectra_npz(spectra)
