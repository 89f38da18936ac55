"""Frames of nuScenes-layout exports with the data of every sensor: the input of models.

**Conventions.** A scene is a sequence, a sample is a frame; its token is the frame token, without the dashes of a UUID.
`global_from_ego` is the robot's pose when a datum was measured; `ego_from_sensor` is its mount. Frames are sorted by
stamp; a prediction may use a sequence's earlier frames. Exports are not trusted: rows are checked, sizes bounded. Files
are opened only when they are read.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from stone.geometry.se3 import SE3
from stone.sensors.calibration import CameraIntrinsics
from stone_base.names import NAME
from stone_exports.cameras import intrinsics_of
from stone_exports.files import ExportContent, ExportFileSpan, Files
from stone_exports.tables import poses_in, row_pose, stamp_of, table_rows, table_span
from stone_files.dataset_layouts import plain_token

FARTHEST_MOUNT_M = 100.0
LIDAR_CHANNEL = "LIDAR_TOP"


@dataclass(frozen=True, eq=False)
class ExportedSensor:
    """One sensor of the rig; only cameras have `intrinsics`."""

    channel: str
    modality: str
    ego_from_sensor: SE3
    intrinsics: CameraIntrinsics | None


@dataclass(frozen=True, eq=False)
class ExportedDatum:
    """One sensor's data of a frame."""

    sensor: ExportedSensor
    stamp_us: int
    global_from_ego: SE3
    span: ExportContent


@dataclass(frozen=True, eq=False)
class ExportedFrame:
    """One frame: its data by channel, and its labels if the export has them."""

    token: str
    sequence: str
    stamp_us: int
    data: Mapping[str, ExportedDatum]
    labels: ExportFileSpan | None

    @property
    def lidar(self) -> ExportedDatum:
        return self.data[LIDAR_CHANNEL]

    def of_modality(self, modality: str) -> tuple[ExportedDatum, ...]:
        """Return the data of all cameras, radars or LiDARs, sorted by channel."""
        return tuple(datum for _, datum in sorted(self.data.items()) if datum.sensor.modality == modality)


def frames_in(files: Files) -> tuple[ExportedFrame, ...]:
    """Return every frame with a sweep, sorted by sequence and stamp. Raises `DamagedExportError`."""
    scenes = _scenes(files)
    data = _data(files)
    frames = []
    for row in table_rows(files, "sample"):
        written, sequence = str(row.get("token")), scenes.get(str(row.get("scene_token")))
        token = plain_token(written)
        if sequence is None or token is None:
            raise table_span(files, "sample").damaged(
                f"frame {written[:40]!r} belongs to no sequence, or is not a frame token"
            )
        if LIDAR_CHANNEL in data.get(written, {}):
            labels = files.span(f"gts/{sequence}/{written}/labels.npz")
            frames.append(ExportedFrame(token, sequence, stamp_of(files, "sample", row), data[written], labels))
    return tuple(sorted(frames, key=lambda frame: (frame.sequence, frame.stamp_us)))


def _scenes(files: Files) -> dict[str, str]:
    """Return the sequence names by token. Raises `DamagedExportError` for an invalid name."""
    names = {str(row.get("token")): str(row.get("name")) for row in table_rows(files, "scene")}
    bad = next((name for name in names.values() if NAME.fullmatch(name) is None), None)
    if bad is not None:
        raise table_span(files, "scene").damaged(f"{bad[:80]!r} is not a valid sequence name")
    return names


def _data(files: Files) -> dict[str, dict[str, ExportedDatum]]:
    """Return the key-frame data by frame token and channel."""
    sensors, poses = _sensors(files), poses_in(files)
    data = dict[str, dict[str, ExportedDatum]]()
    for row in table_rows(files, "sample_data"):
        sensor = sensors.get(str(row.get("calibrated_sensor_token")))
        pose = poses.get(str(row.get("ego_pose_token")))
        if sensor is None or row.get("is_key_frame") is not True:
            continue
        span = files.span(str(row.get("filename")))
        if pose is None or span is None:
            missing = "no pose" if pose is None else "no file"
            raise table_span(files, "sample_data").damaged(f"{str(row.get('filename'))[:200]!r} has {missing}")
        datum = ExportedDatum(sensor, stamp_of(files, "sample_data", row), pose, span)
        data.setdefault(str(row.get("sample_token")), {})[sensor.channel] = datum
    return data


def _sensors(files: Files) -> dict[str, ExportedSensor]:
    """Return the calibrated sensors by token."""
    kinds = {
        str(row.get("token")): (str(row.get("channel")), str(row.get("modality")))
        for row in table_rows(files, "sensor")
    }
    sizes = dict(_picture_sizes(files))
    sensors = dict[str, ExportedSensor]()
    for row in table_rows(files, "calibrated_sensor"):
        token, kind = str(row.get("token")), kinds.get(str(row.get("sensor_token")))
        if kind is None:
            raise table_span(files, "calibrated_sensor").damaged("a row refers to a sensor that does not exist")
        mount = row_pose(files, "calibrated_sensor", row, FARTHEST_MOUNT_M)
        size = sizes.get(token)
        lens = intrinsics_of(files, row, size) if kind[1] == "camera" and size is not None else None
        sensors[token] = ExportedSensor(*kind, mount, lens)
    return sensors


def _picture_sizes(files: Files) -> Iterator[tuple[str, tuple[int, int]]]:
    """Yield width and height in pixels by calibrated sensor, from its first image with a size."""
    seen = set[str]()
    for row in table_rows(files, "sample_data"):
        token, size = str(row.get("calibrated_sensor_token")), (row.get("width"), row.get("height"))
        if token not in seen and all(isinstance(side, int) and 0 < side <= 1 << 15 for side in size):
            seen.add(token)
            yield token, (int(size[0] or 0), int(size[1] or 0))
