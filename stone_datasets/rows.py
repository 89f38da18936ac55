"""Checked values of a row: valid values, and the code of each refusal.

**Conventions.** Every function raises a `DatasetFaultError` that names table, row and token. Rotations are wxyz.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics, CameraModel
from stone_datasets.causes import token_cause, type_cause
from stone_datasets.faults import DatasetPlace, quoted
from stone_datasets.stamps import LARGEST_US, unit_of, wrong_unit
from stone_exports.cameras import COEFFICIENTS
from stone_exports.frames import FARTHEST_MOUNT_M
from stone_exports.tables import FARTHEST_POSE_M
from stone_files.dataset_faults import DatasetFaultError
from stone_files.dataset_layouts import plain_token

__all__ = ["FARTHEST_MOUNT_M", "FARTHEST_POSE_M", "DatasetRow"]

LONGEST_TOKEN = 128
LONGEST_TEXT = 4096
UNIT_WITHIN = 1e-3
LENS_OF_NAN = "did the calibration of the camera fail?"
STAMP_TEXT = re.compile(r"-?[0-9]{1,19}")


@dataclass(frozen=True)
class DatasetRow:
    """One row; `file` is its table's file, `number` counts from 1 (None for an object that is not a row)."""

    file: str
    number: int | None
    values: Mapping[str, Any]
    named: str = ""

    @property
    def place(self) -> DatasetPlace:
        token = self.named or self.values.get("token", "")
        return DatasetPlace(self.file, self.number, token if isinstance(token, str) else "")

    def value(self, key: str) -> Any:
        try:
            return self.values[key]
        except KeyError:
            raise DatasetFaultError("DST-015", self.place, f"it has no {key!r}") from None

    def part(self, key: str) -> "DatasetRow":
        """Return the object under this key."""
        value = self.value(key)
        if not isinstance(value, dict):
            raise self.wrong(key, "an object")
        return DatasetRow(self.file, self.number, value, self.place.token)

    def text(self, key: str) -> str:
        value = self.value(key)
        if not isinstance(value, str) or len(value) > LONGEST_TEXT:
            raise self.wrong(key, "text")
        return value

    def flag(self, key: str) -> bool:
        value = self.value(key)
        if not isinstance(value, bool):
            raise self.wrong(key, "true or false")
        return value

    def count(self, key: str) -> int:
        value = self.value(key)
        if type(value) is not int or not 0 <= value < 1 << 31:
            raise self.wrong(key, "a whole number")
        return value

    def token(self, key: str = "token") -> str:
        """Return a token of any table; `link` also accepts "" for no reference."""
        value = self.text(key)
        if not 0 < len(value) <= LONGEST_TOKEN:
            raise DatasetFaultError("DST-017", self.place, f"{key} is {quoted(value)}")
        return value

    def frame_token(self) -> str:
        """Return the token of a sample as written in the dataset."""
        value = self.token()
        if plain_token(value) is None:
            raise self.no_frame_token(value)
        return value

    def no_frame_token(self, value: str) -> DatasetFaultError:
        return DatasetFaultError("DST-017", self.place, f"{quoted(value)} is not a frame token", token_cause(value))

    def link(self, key: str) -> str:
        """Return prev or next; "" at the ends."""
        return self.text(key) and self.token(key)

    def stamp_us(self, key: str = "timestamp") -> int:
        """Return microseconds of any clock, also from digits as text (annotations.json); `stamps.py` compares them."""
        value = self.value(key)
        if isinstance(value, str) and STAMP_TEXT.fullmatch(value):
            value = int(value)
        if type(value) is not int:
            raise self.wrong(key, "an integer number of microseconds")
        if not -LARGEST_US <= value <= LARGEST_US:
            unit = unit_of(value)
            raise DatasetFaultError(
                "DST-028", self.place, f"{key} is {quoted(value)}", wrong_unit(unit) if unit is not None else ""
            )
        return value

    def numbers(self, key: str, count: int) -> list[float]:
        value = self.value(key)
        if key == "rotation" and is_matrix(value):
            raise DatasetFaultError("DST-021", self.place, f"rotation is {quoted(value)}")
        if (
            not isinstance(value, list)
            or len(value) != count
            or not all(type(number) in (float, int) for number in value)
        ):
            raise self.wrong(key, f"a list of {count} numbers")
        return value

    def pose(self, farthest_m: float) -> SE3:
        """Return `rotation` and `translation` as a pose."""
        return SE3(np.array(self.pose_numbers(farthest_m), np.float64))

    def pose_numbers(self, farthest_m: float) -> list[float]:
        """Return the seven numbers of the pose: w x y z and metres."""
        parts = [*self.numbers("rotation", 4), *self.numbers("translation", 3)]
        if not all(map(_is_finite, parts)):
            raise DatasetFaultError("DST-020", self.place, f"rotation and translation are {quoted(parts)}")
        length = math.hypot(*parts[:4])
        if abs(length - 1) > UNIT_WITHIN:
            likely = "the value was never filled in; the identity rotation is 1, 0, 0, 0" if not length else ""
            what = f"rotation {quoted(parts[:4])} has length {length:.6g}"
            raise DatasetFaultError("DST-022", self.place, what, likely)
        if max(map(abs, parts[4:])) >= farthest_m:
            raise DatasetFaultError(
                "DST-023", self.place, f"translation is {quoted(parts[4:])}; the limit is {farthest_m:g} m"
            )
        return parts

    def lens(self, size_px: tuple[int, int], matrix_key: str = "camera_intrinsic") -> CameraIntrinsics:
        """Return the lens in a camera's row."""
        model, distortion = self.values.get("camera_model", "pinhole"), self.values.get("camera_distortion", [])
        if not isinstance(model, str) or model not in get_args(CameraModel):
            raise DatasetFaultError("DST-026", self.place, f"camera_model is {quoted(model)}")
        if not isinstance(distortion, list) or len(distortion) != COEFFICIENTS[model]:  # type: ignore[index]
            raise DatasetFaultError(
                "DST-026", self.place, f"camera_distortion of a {model} camera is {quoted(distortion)}"
            )
        (fx, _, cx), (_, fy, cy), _ = self._matrix(matrix_key)
        coefficients = self.numbers("camera_distortion", len(distortion)) if distortion else []
        if not all(map(_is_finite, coefficients)):
            raise DatasetFaultError("DST-020", self.place, f"camera_distortion is {quoted(distortion)}", LENS_OF_NAN)
        facts = (float(fx), float(fy), float(cx), float(cy), tuple(map(float, coefficients)))
        return CameraIntrinsics(model, *size_px, *facts)  # type: ignore[arg-type]

    def wrong(self, key: str, wanted: str) -> DatasetFaultError:
        value = self.values.get(key)
        what = f"{key} is {quoted(value)}; expected {wanted}"
        return DatasetFaultError("DST-016", self.place, what, type_cause(key, value))

    def _matrix(self, key: str) -> list[list[float]]:
        value = self.value(key)
        if not is_matrix(value):
            raise DatasetFaultError("DST-024", self.place, f"{key} is {quoted(value)}")
        if not all(type(number) in (float, int) for row in value for number in row):
            raise self.wrong(key, "3 × 3 numbers")
        if not all(_is_finite(number) for row in value for number in row):
            raise DatasetFaultError("DST-020", self.place, f"{key} is {quoted(value)}", LENS_OF_NAN)
        (fx, skew, _), (zero, fy, _), last = value
        if fx <= 0 or fy <= 0 or skew or zero or last != [0, 0, 1]:
            raise DatasetFaultError("DST-025", self.place, f"{key} is {quoted(value)}")
        matrix: list[list[float]] = value
        return matrix


def is_matrix(value: object) -> bool:
    """Return whether the value is three lists of three."""
    is_three = isinstance(value, list) and len(value) == 3
    return is_three and all(isinstance(row, list) and len(row) == 3 for row in value)  # type: ignore[attr-defined]


def _is_finite(number: float) -> bool:
    return abs(number) < 1e308 and math.isfinite(number)
