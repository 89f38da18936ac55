"""Samples of each sensor for a frame, read from the files of a published dataset.

**Conventions.** The datum of a frame is the key frame that `sample_data` says to be of it; of radars the inverse of
`services/labeler/exports/nuscenes/clouds.py`. Pictures that are JPEG stay as they are, others are encoded as those of
recordings are. Of a sweep what is no place near a sensor is left out, and so is what a radar calls invalid. Times are
the sequence's.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.exports.dataset_source import DatasetSource, DatasetSourceFiles
from stone.geometry.se3 import SE3
from stone.sensors.deskew import SweepMount
from stone.sensors.radar_motion import RadarMotion, compensated, radar_motion
from stone.sensors.samples import CameraSample, LidarSample, RadarSample
from stone.sensors.sequence import Sequence
from stone_exports.cameras import MOST_PICTURE_BYTES
from stone_exports.files import ExportFileSpan
from stone_exports.frames import LIDAR_CHANNEL
from stone_exports.radar import FARTHEST_DETECTION_M, WANTED, scan_records
from stone_exports.sweeps import COLUMNS, FARTHEST_RETURN_M, MOST_SWEEP_BYTES
from stone_exports.tables import table_rows, table_span
from stone_recordings.sync.samples import jpeg_of

LAST_RING = np.iinfo(np.uint16).max
VALID_STATE = 0
MEASURED = ("vx", "vy")
Records = NDArray[np.void]
Rates = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DatasetSamples:
    """A SampleSource over an imported scene and its sequence. Picklable: it carries paths only.

    What is read raises `DamagedExportError` where a file is not what its sensor gives.
    """

    source: DatasetSource
    sequence: Sequence

    def lidar(self, index: int) -> LidarSample:
        """The sweep of frame `index`; one without returns of a dataset that has no LiDAR."""
        if self.sequence.frames.sweeps is None:
            return LidarSample(np.zeros((0, 3), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint16))
        span = self._span(LIDAR_CHANNEL, index)
        if span is None:
            raise table_span(self._files, "sample_data").damaged(f"frame {index} has no sweep of {LIDAR_CHANNEL}")
        return lidar_sample(span)

    def camera(self, channel: str, index: int) -> CameraSample | None:
        span = self._span(channel, index)
        if span is None:
            return None
        content, (width_px, height_px) = jpeg_of(span.read(MOST_PICTURE_BYTES))
        return CameraSample(self._taken_ns(channel, index), content, width_px, height_px)

    def radar(self, channel: str, index: int) -> RadarSample | None:
        span, mount = self._span(channel, index), self._radar_mounts.get(channel)
        if span is None or mount is None or self._track is None:
            return None
        stamp_ns, taken_ns = int(self.sequence.frames.stamps_ns[index]), self._taken_ns(channel, index)
        return radar_sample(span, taken_ns, radar_motion(self._track, mount, stamp_ns, taken_ns))

    def _span(self, channel: str, index: int) -> ExportFileSpan | None:
        """The file of the frame's datum; None where the channel has none. Raises `DamagedExportError`."""
        filename = self._filenames.get((self.sequence.frames.tokens[index], channel))
        if filename is None:
            return None
        span = self._files.span(filename)
        if span is None:
            raise table_span(self._files, "sample_data").damaged(f"it names {filename[:200]!r}, which is not there")
        return span

    def _taken_ns(self, channel: str, index: int) -> int:
        frames = self.sequence.frames
        return int(frames.stamps_ns[index]) + int(frames.associations[channel].dt_ns[index])

    @cached_property
    def _files(self) -> DatasetSourceFiles:
        return self.source.opened()

    @cached_property
    def _filenames(self) -> Mapping[tuple[str, str], str]:
        """Of each key-frame datum, by the token of its frame and its channel."""
        return key_frame_files(self._files)

    @cached_property
    def _radar_mounts(self) -> Mapping[str, SE3]:
        radars = self.sequence.calibration.of_kind("radar")
        return {mount.name: mount.lidar_from_sensor for mount in radars}

    @cached_property
    def _track(self) -> SweepMount | None:
        sequence = self.sequence
        if sequence.track is None:
            return None
        return SweepMount(sequence.track, sequence.calibration.ego_from_lidar, sequence.max_pose_gap_ns)


def key_frame_files(files: DatasetSourceFiles) -> dict[tuple[str, str], str]:
    """The file of each key-frame datum by the token of its frame and its channel. Raises `DamagedExportError`."""
    channels = {str(row.get("token")): str(row.get("channel")) for row in table_rows(files, "sensor")}
    mounts = table_rows(files, "calibrated_sensor")
    mounted = {str(row.get("token")): channels.get(str(row.get("sensor_token"))) for row in mounts}
    found = dict[tuple[str, str], str]()
    for row in table_rows(files, "sample_data"):
        channel = mounted.get(str(row.get("calibrated_sensor_token")))
        if channel is not None and row.get("is_key_frame") is True:
            found[str(row.get("sample_token")), channel] = str(row.get("filename"))
    return found


def lidar_sample(span: ExportFileSpan) -> LidarSample:
    """A `.pcd.bin`: rows of x y z intensity ring, float32. Raises `DamagedExportError`."""
    content = span.read(MOST_SWEEP_BYTES)
    if len(content) % (COLUMNS * 4):
        raise span.damaged(f"its {len(content)} bytes are no rows of {COLUMNS} float32")
    rows = np.frombuffer(content, "<f4").reshape(-1, COLUMNS)
    rows = rows[(np.abs(rows[:, :3]) < FARTHEST_RETURN_M).all(axis=1) & (rows[:, :3] != 0).any(axis=1)]
    measured = np.where(np.isfinite(rows[:, 3:]), rows[:, 3:], np.float32(0))
    points_lidar = np.ascontiguousarray(rows[:, :3], np.float32)
    return LidarSample(points_lidar, measured[:, 0], measured[:, 1].clip(0, LAST_RING).astype(np.uint16))


def radar_sample(span: ExportFileSpan, taken_ns: int, motion: RadarMotion) -> RadarSample:
    """A binary PCD of a radar that moved so. Raises `DamagedExportError`."""
    records = _believed(scan_records(span))
    points = _columns(records, WANTED[:3])
    ground_rate_m_s = _rates(points, _columns(records, ("vx_comp", "vy_comp")))
    own = compensated(points, np.zeros(len(points)), motion)
    if set(MEASURED) <= set(records.dtype.names or ()):
        range_rate_m_s = _rates(points, _columns(records, MEASURED))
    else:
        range_rate_m_s = ground_rate_m_s - own.ground_rate_m_s
    rcs_db = records["rcs"].astype(np.float32)
    return RadarSample(taken_ns, points, own.points_lidar, range_rate_m_s, ground_rate_m_s, rcs_db)


def _believed(records: Records) -> Records:
    """Detections that are a place and a motion near a sensor, and that the radar calls valid where it says so."""
    names = records.dtype.names or ()
    measured = _columns(records, (*WANTED, *(name for name in MEASURED if name in names)))
    is_near = np.asarray((np.abs(measured) < FARTHEST_DETECTION_M).all(axis=1))
    is_kept = is_near & (np.linalg.norm(np.where(is_near[:, None], measured[:, :3], 0), axis=1) > 0)
    if "invalid_state" in names:
        is_kept &= records["invalid_state"] == VALID_STATE
    kept: Records = records[is_kept]
    return kept


def _rates(points_radar: Rates, velocities_m_s: Rates) -> Rates:
    """How fast along the ray (N,) what moves so in plan (N, 2) goes; 0 right above or below, where plan says nothing.

    The inverse of `towards * rate`, where a plan velocity is one rate's share in x and in y.
    """
    towards = points_radar[:, :2] / np.linalg.norm(points_radar, axis=1)[:, None]
    square = (towards**2).sum(axis=1)
    rates: Rates = (velocities_m_s * towards).sum(axis=1) / np.where(square > 0, square, np.inf)
    return rates


def _columns(records: Records, names: tuple[str, ...]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # a signalling NaN says so when it is made wider
        columns: Any = [records[name].astype(np.float64) for name in names]
    return np.stack(columns, axis=1)
