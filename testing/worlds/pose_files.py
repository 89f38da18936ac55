"""Files of poses as other programs write them: TUM and KITTI."""

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3


def tum_text(stamps_ns: NDArray[np.int64], poses: SE3) -> str:
    """Return `time x y z qx qy qz qw`, a line each."""
    lines = []
    for stamp_ns, (w, x, y, z), position in zip(stamps_ns.tolist(), poses.wxyz, poses.translation_m, strict=True):
        numbers = " ".join(f"{value:.12f}" for value in (*position, x, y, z, w))
        lines.append(f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} {numbers}\n")
    return "".join(lines)


def kitti_text(poses: SE3) -> str:
    """Return the twelve numbers of each 3 × 4 matrix, a line each."""
    return "".join(" ".join(f"{value:.12e}" for value in matrix[:3].ravel()) + "\n" for matrix in poses.as_matrix())
