"""One document of a calibration bundle, before it is merged with the others.

**Conventions.** Sensors and frames have the names the file gives them; an edge is `parent_from_child`, metres. A lens
without a size (nuScenes) has 0 × 0 pixels here. Numbers come as numbers or as texts of numbers (ROS 1 wrote both).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone.sensors.calibration_checks import Findings
from stone_recordings.calibrations.errors import CalibrationKeyError

Format = Literal[
    "native", "ros_camera_info", "kalibr", "opencalib", "nuscenes", "autoware", "kitti", "rellis", "opencv", "tf_static"
]
LONGEST_NAME = 100
LARGEST_COUNT = 100_000
OFFSET_LIMIT_S = 1000.0


@dataclass(frozen=True, eq=False)
class Edge:
    parent: str
    child: str
    parent_from_child: SE3


@dataclass(frozen=True, eq=False)
class CalibrationPart:
    """`lenses` and `offsets_ns` by camera; `kinds` of frames that the file itself calls sensors.

    `optical` are frames known to be optical (z forward); the others are judged by how they are turned.
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
    """A value inside a document, and the way to it; every reading checks and names it in its refusal.

    Raises CalibrationKeyError throughout.
    """

    file: str
    key: str
    value: object

    def refused(self, problem: str) -> CalibrationKeyError:
        shown = "" if isinstance(self.value, (dict, list)) else f", not {str(self.value)[:40]!r}"
        return CalibrationKeyError(self.file, self.key[:120], problem + shown, 0)

    def entries(self) -> dict[str, "Node"]:
        """The entries of a mapping, in order, by key."""
        if not isinstance(self.value, dict):
            raise self.refused("a mapping is expected")
        return {str(key): self._inner(str(key), value) for key, value in self.value.items()}

    def items(self) -> list["Node"]:
        if not isinstance(self.value, list):
            raise self.refused("a list is expected")
        return [self._inner(str(place), value) for place, value in enumerate(self.value)]

    def has(self, key: str) -> bool:
        return isinstance(self.value, dict) and key in self.value

    def at(self, key: str) -> "Node":
        entries = self.entries()
        if key not in entries:
            raise CalibrationKeyError(self.file, f"{self.key}.{key}".lstrip(".")[:120], "Field required", 0)
        return entries[key]

    def number(self) -> float:
        if isinstance(self.value, (int, float, str)) and not isinstance(self.value, bool):
            try:
                return float(self.value)
            except (ValueError, OverflowError):
                pass
        raise self.refused("a number is expected")

    def whole(self, what: str = "pixels") -> int:
        """A count, at least 1."""
        number = self.number()
        if not (1 <= number <= LARGEST_COUNT and number == int(number)):
            raise self.refused(f"a whole number of {what} from 1 to {LARGEST_COUNT} is expected")
        return int(number)

    def offset_ns(self) -> int:
        """Seconds as whole nanoseconds."""
        seconds = self.number()
        if not abs(seconds) <= OFFSET_LIMIT_S:
            raise self.refused(f"a time of at most {OFFSET_LIMIT_S:g} s is expected")
        return round(seconds * 1e9)

    def text(self) -> str:
        if not isinstance(self.value, str) or len(self.value) > LONGEST_NAME:
            raise self.refused(f"a text of at most {LONGEST_NAME} characters is expected")
        return self.value

    def words(self) -> list["Node"]:
        """What a line has between its spaces."""
        if not isinstance(self.value, (int, float, str)):
            raise self.refused("numbers between spaces are expected")
        return [Node(self.file, self.key, word) for word in str(self.value).split()]

    def vector(self) -> NDArray[np.float64]:
        return np.array([item.number() for item in self.items()], np.float64)

    def matrix(self, rows: int, columns: int) -> NDArray[np.float64]:
        """Rows of numbers, or all of them in one list by rows (OpenCV, msckf)."""
        items = self.items()
        is_nested = any(isinstance(item.value, list) for item in items)
        numbers = [item.vector() for item in items] if is_nested else [self.vector()]
        shape = (len(numbers), *{len(row) for row in numbers})
        if shape != ((rows, columns) if is_nested else (1, rows * columns)):
            raise self.refused(f"{rows} rows of {columns} numbers are expected")
        return np.concatenate(numbers).reshape(rows, columns)

    def _inner(self, key: str, value: object) -> "Node":
        return Node(self.file, f"{self.key}.{key}".lstrip("."), value)
