"""Camera matrices and distortion vectors of all formats → one kind of intrinsics.

**Conventions.** A 3 × 3 matrix K with no skew; the names of lens models are those of ROS, Kalibr and OpenCV. `radtan`
is plumb_bob without k3. Sizes of 0 mean that the file does not say.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.sensors.calibration import CameraIntrinsics, CameraModel
from stone.sensors.calibration_errors import DistortionLengthError, NotFiniteError
from stone_recordings.calibrations.errors import LensModelError
from stone_recordings.calibrations.part import Node

MODELS: dict[str, CameraModel] = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
    "none": "pinhole",
    "pinhole": "pinhole",
}
# Models whose vectors are written without their last coefficient, which is then 0.
SHORT_BY_ONE = ("radtan",)


@dataclass(frozen=True)
class LensText:
    """What a file calls the lens: `sensor` for messages, `model` in its own word, the distortion as written."""

    file: str
    sensor: str
    model: str
    distortion: tuple[float, ...]


def intrinsics(lens: LensText, matrix: NDArray[np.float64], size_px: tuple[int, int]) -> CameraIntrinsics:
    """Raises LensModelError, DistortionLengthError, NotFiniteError, CalibrationKeyError (skew)."""
    model = MODELS.get(lens.model or ("plumb_bob" if lens.distortion else "none"))
    if model is None:
        raise LensModelError(lens.file, lens.sensor, lens.model)
    if not np.isfinite(matrix).all():
        raise NotFiniteError(lens.sensor, "the camera matrix")
    distortion = lens.distortion
    if lens.model in SHORT_BY_ONE:
        if len(distortion) != 4:
            raise DistortionLengthError(lens.sensor, lens.model, len(distortion), 4)
        distortion = (*distortion, 0.0)
    if model == "pinhole" and not any(distortion):
        distortion = ()
    if abs(matrix[0, 1]) > 1e-9 or np.abs(matrix[2] - (0, 0, 1)).max() > 1e-9 or abs(matrix[1, 0]) > 1e-9:
        key = f"{lens.sensor} camera matrix"
        raise Node(lens.file, key, matrix.tolist()).refused("rows fx 0 cx, 0 fy cy, 0 0 1 without skew are expected")
    focal, centre = (float(matrix[0, 0]), float(matrix[1, 1])), (float(matrix[0, 2]), float(matrix[1, 2]))
    return CameraIntrinsics(model, *size_px, *focal, *centre, distortion)


def distortion_of(node: Node) -> tuple[float, ...]:
    """A list of coefficients, or a list that holds one."""
    items = node.items()
    if len(items) == 1 and isinstance(items[0].value, list):
        return distortion_of(items[0])
    return tuple(item.number() for item in items)
