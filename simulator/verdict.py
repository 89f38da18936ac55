"""How far label files agree with the truth of a simulated world.

**Conventions.** Predicted drivable = label 1 (T) or 2 (P); predicted not = 3 (N). Counted are occupied voxels
(label > 0) that the truth judges, over all frames; ratios are read once at the end and are None without support.
"""

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.truth import DRIVABLE, NOT_DRIVABLE, Truth
from stone.errors import ShapeError, StoneError
from stone.se3 import Array
from stone.sequence import frame_token

GRID_SHAPE = (256, 256, 32)
GRID_MIN_M = (-25.6, -25.6, -2.0)
VOXEL_M = 0.2


class NoLabelsError(StoneError):
    """No frame of the labels belongs to this truth."""

    code = "no_labels_of_this_truth"

    def __init__(self, gts_dir: Path) -> None:
        super().__init__(f"{gts_dir} holds no labels for the sweeps of this truth; expected <sequence>/<frame_token>")


@dataclass(frozen=True)
class Verdict:
    """Counts of judged voxels: drivable or not in truth × labelled drivable or not."""

    frames: int
    drivable_kept: int
    drivable_lost: int
    blocked_kept: int
    blocked_lost: int

    @property
    def iou(self) -> float | None:
        return _ratio(self.drivable_kept, self.drivable_kept + self.drivable_lost + self.blocked_kept)

    @property
    def precision(self) -> float | None:
        return _ratio(self.drivable_kept, self.drivable_kept + self.blocked_kept)

    @property
    def recall(self) -> float | None:
        return _ratio(self.drivable_kept, self.drivable_kept + self.drivable_lost)

    @property
    def everything_iou(self) -> float | None:
        """What labelling every occupied voxel traversable would score: the drivable share."""
        drivable = self.drivable_kept + self.drivable_lost
        return _ratio(drivable, drivable + self.blocked_kept + self.blocked_lost)

    def as_record(self) -> dict[str, float | int | None]:
        ratios = {name: getattr(self, name) for name in ("iou", "precision", "recall", "everything_iou")}
        return asdict(self) | ratios


def judge_labels(gts_dir: Path, truth: Truth) -> Verdict:
    """Judge every `<gts_dir>/<sequence>/<frame_token>/labels.npz` of this drive.

    Raises `NoLabelsError` when none is found.
    """
    counts = [
        judge_semantics(_semantics(path), truth.judge, truth.map_from_ego(stamp_ns).as_matrix())
        for path, stamp_ns in label_files(gts_dir, truth)
    ]
    if not counts:
        raise NoLabelsError(gts_dir)
    kept, lost, blocked_kept, blocked_lost = np.sum(counts, axis=0).tolist()
    return Verdict(len(counts), kept, lost, blocked_kept, blocked_lost)


def label_files(gts_dir: Path, truth: Truth) -> Iterator[tuple[Path, int]]:
    """Label files with the stamps of their sweeps, in time order; the sequence's name is its folder's."""
    for sequence in sorted(path for path in gts_dir.iterdir() if path.is_dir()):
        for stamp_ns in truth.sweep_stamps_ns.tolist():
            path = sequence / frame_token(sequence.name, stamp_ns) / "labels.npz"
            if path.is_file():
                yield path, stamp_ns


def judge_semantics(
    semantics: NDArray[np.uint8], judge: Callable[[Array], NDArray[np.uint8]], map_from_ego: Array
) -> NDArray[np.int64]:
    """(4,) counts of one frame: drivable kept and lost, blocked kept and lost."""
    index = np.argwhere(semantics > 0)
    label = semantics[tuple(index.T)]
    centres = (index + 0.5) * VOXEL_M + np.asarray(GRID_MIN_M)
    verdict = judge(centres @ map_from_ego[:3, :3].T + map_from_ego[:3, 3])
    is_kept = label < 3
    return np.array(
        [
            np.count_nonzero((verdict == truth) & (is_kept == kept))
            for truth in (DRIVABLE, NOT_DRIVABLE)
            for kept in (True, False)
        ]
    )


def _semantics(path: Path) -> NDArray[np.uint8]:
    with np.load(path, allow_pickle=False) as archive:
        semantics: NDArray[np.uint8] = archive["semantics"]
    if semantics.shape != GRID_SHAPE:
        raise ShapeError(f"semantics of {path}", semantics.shape, str(GRID_SHAPE))
    return semantics


def _ratio(part: int, whole: int) -> float | None:
    return part / whole if whole else None
