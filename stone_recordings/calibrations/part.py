"""One document of a calibration bundle, before it is merged with the others.

**Conventions.** Sensors and frames have the names in the file; an edge is `parent_from_child`, metres. A lens without a
size (nuScenes) has 0 × 0 pixels here. Numbers are numbers or texts of numbers (ROS 1 wrote both).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused
from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, CameraModel, SensorKind
from stone.sensors.calibration_checks import Findings
from stone.sensors.calibration_errors import distortion_length, not_finite
from stone_files.joined_file import MOST_OFFSET_NS
from stone_recordings.calibrations.errors import bad_calibration_key, unread_lens_model

Format = Literal[
    "native",
    "ros_camera_info",
    "kalibr",
    "opencalib",
    "nuscenes",
    "autoware",
    "kitti",
    "rellis",
    "opencv",
    "tf_static",
    "visual_lidar",
    "fast_livo2",
    "fast_lio",
    "lio_sam",
    "urdf",
]
LONGEST_NAME = 100
LARGEST_COUNT = 100_000


@dataclass(frozen=True, eq=False)
class Edge:
    parent: str
    child: str
    parent_from_child: SE3


@dataclass(frozen=True, eq=False)
class CalibrationPart:
    """`lenses` and `offsets_ns` by camera; `kinds` of the frames that the file itself calls sensors.

    `optical` are frames known to be optical (z forward); the others are judged by their rotation.
    """

    file: str
    format: Format | None
    edges: tuple[Edge, ...] = ()
    lenses: Mapping[str, CameraIntrinsics] = field(default_factory=dict)
    offsets_ns: Mapping[str, int] = field(default_factory=dict)
    kinds: Mapping[str, SensorKind] = field(default_factory=dict)
    optical: frozenset[str] = frozenset()
    findings: Findings = ()


@dataclass(frozen=True)
class Node:
    """A value inside a document, and its path; every reading checks the value and names the path in its refusal.

    Raises `CAL-422` throughout.
    """

    file: str
    key: str
    value: object

    def refused(self, problem: str) -> Refused:
        shown = "" if isinstance(self.value, (dict, list)) else f", not {str(self.value)[:40]!r}"
        return bad_calibration_key(self.file, self.key[:120], problem + shown, 0)

    def entries(self) -> dict[str, "Node"]:
        """Return the entries of a mapping, in order, by key."""
        if not isinstance(self.value, dict):
            raise self.refused("a mapping is expected")
        return {str(key): self._inner(str(key), value) for key, value in self.value.items()}

    def items(self) -> list["Node"]:
        if not isinstance(self.value, list):
            raise self.refused("a list is expected")
        return [self._inner(str(index), value) for index, value in enumerate(self.value)]

    def has(self, key: str) -> bool:
        return isinstance(self.value, dict) and key in self.value

    def at(self, key: str) -> "Node":
        entries = self.entries()
        if key not in entries:
            raise bad_calibration_key(self.file, f"{self.key}.{key}".lstrip(".")[:120], "Field required", 0)
        return entries[key]

    def number(self) -> float:
        if isinstance(self.value, (int, float, str)) and not isinstance(self.value, bool):
            try:
                return float(self.value)
            except (ValueError, OverflowError):
                pass
        raise self.refused("a number is expected")

    def whole(self, what: str = "pixels") -> int:
        """Return a count, at least 1."""
        number = self.number()
        if not (1 <= number <= LARGEST_COUNT and number == int(number)):
            raise self.refused(f"a whole number of {what} from 1 to {LARGEST_COUNT} is expected")
        return int(number)

    def offset_ns(self) -> int:
        """Return seconds as whole nanoseconds."""
        if not abs(self.number()) * 1e9 <= MOST_OFFSET_NS:
            raise self.refused(f"a time of at most {MOST_OFFSET_NS / 1e9:.0f} s is expected")
        return round(Decimal(str(self.value)) * 10**9)

    def text(self) -> str:
        if not isinstance(self.value, str) or len(self.value) > LONGEST_NAME:
            raise self.refused(f"a text of at most {LONGEST_NAME} characters is expected")
        return self.value

    def words(self) -> list["Node"]:
        """Return the words of a line."""
        if not isinstance(self.value, (int, float, str)):
            raise self.refused("numbers between spaces are expected")
        return [Node(self.file, self.key, word) for word in str(self.value).split()]

    def vector(self) -> NDArray[np.float64]:
        return np.array([item.number() for item in self.items()], np.float64)

    def matrix(self, rows: int, columns: int) -> NDArray[np.float64]:
        """Return rows of numbers, or all of them in one list by rows (OpenCV, msckf)."""
        items = self.items()
        is_nested = any(isinstance(item.value, list) for item in items)
        numbers = [item.vector() for item in items] if is_nested else [self.vector()]
        shape = (len(numbers), *{len(row) for row in numbers})
        if shape != ((rows, columns) if is_nested else (1, rows * columns)):
            raise self.refused(f"{rows} rows of {columns} numbers are expected")
        return np.concatenate(numbers).reshape(rows, columns)

    def _inner(self, key: str, value: object) -> "Node":
        return Node(self.file, f"{self.key}.{key}".lstrip("."), value)


# Camera matrices and distortion vectors of all formats → one kind of intrinsics. A 3 × 3 matrix K with no skew; the
# names of lens models are those of ROS, Kalibr and OpenCV. `radtan` is plumb_bob without k3. Sizes of 0 mean that the
# file lacks them.


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
    """A file's names for the lens: `sensor` for messages, `model` in its own word, the distortion as written."""

    file: str
    sensor: str
    model: str
    distortion: tuple[float, ...]


def intrinsics(lens: LensText, matrix: NDArray[np.float64], size_px: tuple[int, int]) -> CameraIntrinsics:
    """Return the intrinsics. Raises `CAL-427`, `CAL-410`, `CAL-416`, `CAL-422` (skew)."""
    model = MODELS.get(lens.model or ("plumb_bob" if lens.distortion else "none"))
    if model is None:
        raise unread_lens_model(lens.file, lens.sensor, lens.model)
    if not np.isfinite(matrix).all():
        raise not_finite(lens.sensor, "the camera matrix")
    distortion = lens.distortion
    if lens.model in SHORT_BY_ONE:
        if len(distortion) != 4:
            raise distortion_length(lens.sensor, lens.model, len(distortion), 4)
        distortion = (*distortion, 0.0)
    if model == "pinhole" and not any(distortion):
        distortion = ()
    if abs(matrix[0, 1]) > 1e-9 or np.abs(matrix[2] - (0, 0, 1)).max() > 1e-9 or abs(matrix[1, 0]) > 1e-9:
        key = f"{lens.sensor} camera matrix"
        raise Node(lens.file, key, matrix.tolist()).refused("rows fx 0 cx, 0 fy cy, 0 0 1 without skew are expected")
    focal, centre = (float(matrix[0, 0]), float(matrix[1, 1])), (float(matrix[0, 2]), float(matrix[1, 2]))
    return CameraIntrinsics(model, *size_px, *focal, *centre, distortion)


def distortion_of(node: Node) -> tuple[float, ...]:
    """Return a list of coefficients, also from a list that holds one."""
    items = node.items()
    if len(items) == 1 and isinstance(items[0].value, list):
        return distortion_of(items[0])
    return tuple(item.number() for item in items)
