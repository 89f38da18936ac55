"""One frame of a dataset: its labels, poses and sensor data, each read at its first access.

**Conventions.** Labels are aligned with the ego frame at the frame's stamp: axes x forward, y left, z up. The lower
corner of voxel [i, j, k] is `grid.min_m` + [i, j, k] · `grid.voxel_m`. Transforms are homogeneous matrices (4, 4)
float64, metres. `map` is the dataset's `global`. Cameras are optical: z forward, x right, y down.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from stone.sensors.calibration import CameraIntrinsics
from stone_base.errors import Refused
from stone_base.label_grid import LabelGrid
from stone_datasets.classes import ClassMap
from stone_datasets.labels import FrameLabels, read_labels
from stone_exports.cameras import recorded_picture
from stone_exports.frames import LIDAR_CHANNEL, ExportedDatum, ExportedFrame
from stone_exports.labels import detections_ego
from stone_exports.sweeps import SweepFile
from stone_files.dataset_layouts import DatasetLayout

Matrix = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class SensorCalibration:
    """The mount of a sensor. A camera has `intrinsics` (3, 3), and its `lens` with the model and its distortion."""

    channel: str
    modality: str
    ego_from_sensor: Matrix
    intrinsics: Matrix | None
    lens: CameraIntrinsics | None


@dataclass(frozen=True, eq=False)
class LabelFormat:
    """The format of a dataset's label files."""

    layout: DatasetLayout
    classes: ClassMap


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame. `map_from_ego` is the pose at its stamp, None if the dataset has no poses."""

    exported: ExportedFrame = field(repr=False)
    stamp_ns: int
    map_from_ego: Matrix | None = field(repr=False)
    format: LabelFormat = field(repr=False)

    @property
    def token(self) -> str:
        """The token: 32 hex digits, also if the dataset writes a UUID."""
        return self.exported.token

    @property
    def sequence(self) -> str:
        """The name of its sequence."""
        return self.exported.sequence

    @property
    def grid(self) -> LabelGrid:
        """The grid of its labels."""
        return self.format.layout.grid

    @property
    def is_labelled(self) -> bool:
        """Whether it has labels."""
        return self.exported.labels is not None

    @property
    def semantics(self) -> NDArray[np.uint8]:
        """Classes of the grid's shape: 0 free or unknown, 1 T, 2 P, 3 N. Raises `frame_unlabelled`."""
        return self._labels.classes

    @property
    def observed(self) -> NDArray[np.bool_]:
        """Whether each voxel was observed; True everywhere if the labels lack a mask. Raises `frame_unlabelled`."""
        mask = self._labels.mask_lidar
        return np.ones(self.grid.shape, np.bool_) if mask is None else mask.astype(np.bool_)

    @property
    def channels(self) -> tuple[str, ...]:
        """The sensors with data in this frame."""
        return tuple(sorted(self.exported.data))

    @property
    def calibration(self) -> Mapping[str, SensorCalibration]:
        """The mounts and lenses of its sensors by channel."""
        return {channel: _calibration(self.exported.data[channel]) for channel in self.channels}

    @property
    def sweep(self) -> NDArray[np.float32]:
        """The LiDAR points (N, 4): x y z in the ego frame, metres, and intensity. Raises `channel_missing`."""
        datum = self._datum(LIDAR_CHANNEL)
        return SweepFile(datum.span, datum.sensor.ego_from_sensor).returns_ego()

    def image(self, channel: str) -> NDArray[np.uint8]:
        """Return the original RGB image (height, width, 3) of a camera. Raises `channel_missing`."""
        datum = self._datum(channel, "camera")
        return recorded_picture(datum.span, datum.sensor.intrinsics)

    def scan(self, channel: str) -> NDArray[np.float32]:
        """Return detections (N, 6) of a radar: x y z in the ego frame, RCS in dBsm, v_x v_y over ground.

        Raises `channel_missing`.
        """
        return detections_ego(self._datum(channel, "radar"))

    def pose(self, channel: str) -> Matrix:
        """Return `map_from_ego` at the time of this sensor's measurement. Raises `channel_missing`."""
        return self._datum(channel).global_from_ego.as_matrix()

    @cached_property
    def _labels(self) -> FrameLabels:
        if self.exported.labels is None:
            raise Refused(
                "frame_unlabelled", f"frame {self.token} of {self.sequence} has no labels.npz in this dataset"
            )
        return read_labels(self.exported.labels, self.format.classes, self.format.layout)

    def _datum(self, channel: str, modality: str = "") -> ExportedDatum:
        datum = self.exported.data.get(channel)
        if datum is None or modality not in ("", datum.sensor.modality):
            has = f"it has data of {', '.join(self.channels)}" if self.channels else "label sets have no sensor data"
            wanted = f"{modality} {channel[:40]!r}".strip()
            raise Refused("channel_missing", f"frame {self.token} of {self.sequence} has no data of {wanted}; {has}")
        return datum


def _calibration(datum: ExportedDatum) -> SensorCalibration:
    sensor, lens = datum.sensor, datum.sensor.intrinsics
    matrix = None
    if lens is not None:
        matrix = np.array([[lens.fx_px, 0.0, lens.cx_px], [0.0, lens.fy_px, lens.cy_px], [0.0, 0.0, 1.0]])
    return SensorCalibration(sensor.channel, sensor.modality, sensor.ego_from_sensor.as_matrix(), matrix, lens)
