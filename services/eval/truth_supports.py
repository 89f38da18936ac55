"""The counts of a ground truth alone, which bound the counts of any submission against it.

**Conventions.** The parent checks a child's counts of a submission against these supports. Another child, which reads
no submission, reads the supports. Supports are those of `TruthPack.supports`, int32 (frame, ring, 13).
"""

from collections.abc import Mapping
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.eval.truth_pack import NOT_KEPT, SUPPORTS, TruthPack, TruthPackError
from services.runtime.sandbox import SandboxCrashedError, SandboxLimits, sandboxed
from stone.errors import PlatformFaultError
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS
from stone_submissions.errors import UnreadableInputError

Supports = NDArray[np.int32]
FRAME_BYTES = 4 * RINGS * SUPPORTS


def supports_of(pack_path: Path, frames: int) -> Supports:
    """Return the supports of all frames of a pack; they are cached.

    Raises `ground_truth_damaged`, `SandboxInterruptedError`.
    """
    try:
        stat = pack_path.stat()
        return _kept(pack_path, (stat.st_ino, stat.st_mtime_ns, stat.st_size), frames)
    except (OSError, SandboxCrashedError, TruthPackError, UnreadableInputError) as error:
        raise truth_damaged() from error


@lru_cache(maxsize=4)
def _kept(pack_path: Path, _version: tuple[int, ...], frames: int) -> Supports:
    limits = SandboxLimits(cpu_s=60, answer_bytes=frames * FRAME_BYTES, reads=(pack_path,))
    answer = sandboxed(partial(read_supports, pack_path), limits)
    if len(answer) != frames * FRAME_BYTES:
        raise SandboxCrashedError(f"returned supports of other than {frames} frames")
    return np.frombuffer(answer, "<i4").reshape(frames, RINGS, SUPPORTS)


def read_supports(pack_path: Path) -> bytes:
    """Return the supports in a pack; runs in the child. Raises `TruthPackError`, `UnreadableInputError`."""
    with TruthPack(pack_path) as pack:
        return pack.supports().astype("<i4").tobytes()


def can_be_counted(counts: Mapping[str, NDArray[np.int32]], supports: Supports, is_sampled: NDArray[np.bool_]) -> bool:
    """Return whether some prediction has these `Counts.arrays` against a ground truth with these supports.

    `is_sampled` (F,) marks the frames whose columns are counted.
    """
    confusions, bev, pairs, columns, late = (
        counts[name].astype(np.int64) for name in ("confusions", "bev", "pairs", "columns", "late")
    )
    if min(array.min(initial=0) for array in (confusions, bev, pairs, columns, late)) < 0:
        return False
    voxels, drivable = supports[..., :CLASSES], supports[..., CLASSES]
    of_columns, of_late = np.split(supports[..., CLASSES + 1 :], 2, axis=-1)
    is_known, is_counted = drivable != NOT_KEPT, is_sampled[:, None]
    beside = of_columns.sum(axis=-1) - drivable
    wrong = (
        confusions.sum(axis=-1) != voxels,
        pairs > _most_pairs(confusions),
        is_known & ((bev[..., 0] + bev[..., 1] != drivable) | (bev[..., 2] > beside)),
        is_known & is_counted & (columns.sum(axis=-1) != of_columns).any(axis=-1),
        (late > confusions.sum(axis=1)).any(axis=(-2, -1)),
        is_known.all(axis=-1) & (late.sum(axis=-1) != of_late.sum(axis=1)).any(axis=-1),
        ~is_sampled & (late != 0).any(axis=(-2, -1)),
        ~is_counted & ((pairs != 0).any(axis=-1) | (columns != 0).any(axis=(-2, -1))),
    )
    return not any(is_wrong.any() for is_wrong in wrong)


def _most_pairs(confusions: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the upper bound of pairs (F, ring, set) for occupied, T, P, N: a pair takes one voxel of each side."""
    truth, prediction = confusions.sum(axis=-1), confusions.sum(axis=-2)
    fewest: NDArray[np.int64] = np.minimum(truth, prediction)
    fewest[..., 0] = np.minimum(truth[..., 1:].sum(axis=-1), prediction[..., 1:].sum(axis=-1))
    return fewest


def truth_damaged() -> PlatformFaultError:
    return PlatformFaultError(
        "ground_truth_damaged",
        "the stored ground truth cannot be read; was the store changed by hand, or is it unavailable?",
    )
