"""The scores of a submission: per-frame confusions are kept, everything else is read from them.

**Conventions.** Frames follow `tokens`, sequences are contiguous runs of them. Rows truth, columns prediction.
"""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from stone.bitplanes import RING_EDGES_M, Confusion
from stone.confusion import Signature, ious, supports, within_occupied

RING_NAMES = tuple(
    f"{low:g}-{high:g}m" if high else f"from-{low:g}m"
    for low, high in zip((0.0, *RING_EDGES_M), (*RING_EDGES_M, None), strict=True)
)


@dataclass(frozen=True, eq=False)
class Scores:
    """One submission against one ground truth: `confusions` [frame, ring, 4, 4] int32, `sequences` name → frames."""

    tokens: tuple[str, ...]
    sequences: dict[str, slice]
    confusions: Confusion
    signature: Signature

    @property
    def total(self) -> NDArray[np.int64]:
        """The confusion (4, 4) of everything."""
        return _added(self.confusions, (0, 1))

    def as_record(self) -> dict[str, object]:
        """What `stone score --json` prints; ratios in [0, 1] or None where undefined."""
        return {
            "frames": len(self.tokens),
            **asdict(ious(self.total)),
            "iou_within_occupied": _within(self.total),
            "confusion": self.total.tolist(),
            "signature": str(self.signature),
            "support": supports(self.total),
            "rings": dict(zip(RING_NAMES, map(_part, self._by_ring()), strict=True)),
            "sequences": {name: _part(self._of_sequence(frames)) for name, frames in self.sequences.items()},
        }

    def _by_ring(self) -> NDArray[np.int64]:
        return _added(self.confusions, 0)

    def _of_sequence(self, frames: slice) -> NDArray[np.int64]:
        return _added(self.confusions[frames], (0, 1))


def _added(confusions: Confusion, axes: int | tuple[int, ...]) -> NDArray[np.int64]:
    return np.asarray(confusions.sum(axis=axes, dtype=np.int64))


def _part(confusion: NDArray[np.int64]) -> dict[str, object]:
    return {**asdict(ious(confusion)), "support": supports(confusion)}


def _within(confusion: NDArray[np.int64]) -> dict[str, float | None]:
    """Over voxels occupied in truth; there IoU_occ is the share of them that the prediction found."""
    return asdict(ious(within_occupied(confusion)))
