"""Samples of each sensor for a frame: the sweep deskewed, the picture as recorded, the radar's scan.

**Conventions.** The recording is opened once per process and thread and stays open; reading samples in the order of
frames is cheap. The sequence determines the message of a frame; nothing is associated again.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from stone.errors import Refused
from stone.geometry.se3 import SE3
from stone.sensors.deskew import BIN_NS, SweepMount, deskew, sweep_motion
from stone.sensors.radar_motion import compensated, radar_motion
from stone.sensors.samples import CameraSample, LidarSample, RadarSample
from stone.sensors.sequence import Association, Sequence
from stone_files.bag_fingerprint import recording_sha256
from stone_recordings.bags.errors import IngestError
from stone_recordings.clocks.point_clock import points_in
from stone_recordings.messages.camera import COMPRESSED, CameraPicture, check_end, decode_image, head_of
from stone_recordings.messages.lidar import LidarPoints
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.sweep_clouds import cloud_at
from stone_recordings.sync.sweeps import BagSweeps, opened

# Radar detections of each frame, moved to the frame's stamp and corrected for the robot's own motion. Points are in the
# LiDAR frame at the frame's stamp, like those of a sweep. A radar measured `dt_ns` of its association after the stamp.
# Only detections that the radar itself marks as valid are kept, in its order.


@dataclass(frozen=True, eq=False)
class BagRadar:
    """One radar's topic by frame. Picklable: it carries the path, never the open file."""

    path: Path
    taken: Association
    stamps_ns: NDArray[np.int64]
    lidar_from_radar: SE3
    mount: SweepMount

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def frame(self, index: int) -> RadarSample | None:
        """Return the detections for frame `index`; None if no message is near enough, or the message cannot be read.

        Raises IndexError, and the errors of opening the bag (BAG-*).
        """
        row, stamp_ns = int(self.taken.message_index[index]), int(self.stamps_ns[index])
        if row < 0:
            return None
        bag, taken_ns = opened(self.path), stamp_ns + int(self.taken.dt_ns[index])
        topic = next(topic for topic in bag.topics if topic.name == self.taken.topic)
        message = bag.message(topic.name, row)
        try:
            seen = decode_radar(topic.type, [message], topic.schema)
        except IngestError:  # `radar_findings` reports it
            return None
        motion = radar_motion(self.mount, self.lidar_from_radar, stamp_ns, taken_ns)
        points_radar, range_rate_m_s = seen.points_radar[seen.is_valid], seen.range_rate_m_s[seen.is_valid]
        moved = compensated(points_radar, range_rate_m_s.astype(np.float64), motion)
        return RadarSample(
            taken_ns,
            points_radar,
            moved.points_lidar,
            range_rate_m_s.astype(np.float64),
            moved.ground_rate_m_s,
            seen.rcs_db[seen.is_valid],
        )


def radars_of(sequence: Sequence, sweeps: BagSweeps) -> Mapping[str, BagRadar]:
    """Return the radars that the calibration places, by channel; none if sweeps have no track."""
    if sweeps.mount is None:
        return {}
    taken = sequence.frames.associations
    return {
        mount.name: BagRadar(
            sweeps.path, taken[mount.name], sequence.frames.stamps_ns, mount.lidar_from_sensor, sweeps.mount
        )
        for mount in sequence.calibration.of_kind("radar")
        if mount.name in taken
    }


INTENSITY_NAMES = ("intensity", "reflectivity", "i")
# For pictures that were not recorded as JPEG; colours keep their full resolution.
JPEG_QUALITY = 95


@dataclass(frozen=True, eq=False)
class BagSamples:
    """A SampleSource over a recording and its sequence. Picklable: it carries the path only."""

    path: Path
    sequence: Sequence

    def lidar(self, index: int) -> LidarSample:
        """Read the sweep. Raises IndexError, `not_recorded`, `point_offset`, and the errors of reading (BAG-*,
        MSG-*).
        """
        sweeps = self._sweeps
        bag = opened(self.path)
        cloud = cloud_at(bag, sweeps.topic, int(sweeps.message_index[index]))
        sweep = points_in(bag, sweeps.topic, cloud)
        ring = np.zeros(len(sweep.rows), np.uint16) if sweep.ring is None else sweep.ring
        points_lidar, is_kept = self._deskewed(sweep, int(sweeps.stamps_ns[index]))
        return LidarSample(points_lidar, _intensity(cloud.points, sweep.rows)[is_kept], ring[is_kept])

    def camera(self, channel: str, index: int) -> CameraSample | None:
        """Return the picture; None if none was taken, or it cannot be read.

        Raises IndexError, and the errors of opening the bag (BAG-*).
        """
        taken = self.sequence.frames.associations.get(channel)
        if taken is None or taken.message_index[index] < 0:
            return None
        bag = opened(self.path)
        topic = next(topic for topic in bag.topics if topic.name == taken.topic)
        payload = bag.message(topic.name, int(taken.message_index[index])).payload
        try:
            picture = decode_image(payload, topic.type)
            content = as_jpeg(picture)
        except IngestError:  # `picture_findings` and `RecordedTopics.left_out` report it
            return None
        return CameraSample(self._taken_ns(taken, index), content, picture.width_px, picture.height_px)

    def radar(self, channel: str, index: int) -> RadarSample | None:
        """Return the scan; raises the errors of `camera`. A sequence without a track has no radar samples."""
        radar = self._radars.get(channel)
        return None if radar is None else radar.frame(index)

    def _taken_ns(self, taken: Association, index: int) -> int:
        return int(self.sequence.frames.stamps_ns[index]) + int(taken.dt_ns[index])

    @cached_property
    def _sweeps(self) -> BagSweeps:
        frames, sequence = self.sequence.frames, self.sequence
        if frames.sweeps is None:
            raise Refused(
                "not_recorded",
                f"the frames of sequence {sequence.name} name no LiDAR messages: the sequence was made without a "
                "recording",
            )
        mount = None
        if sequence.track is not None:
            mount = SweepMount(sequence.track, sequence.calibration.ego_from_lidar, sequence.max_pose_gap_ns)
        return BagSweeps(self.path, frames.sweeps.topic, frames.sweeps.message_index, frames.stamps_ns, mount)

    @cached_property
    def _radars(self) -> Mapping[str, BagRadar]:
        return radars_of(self.sequence, self._sweeps)

    def _deskewed(self, sweep: LidarPoints, stamp_ns: int) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """Return the points at the stamp, and a mask of the points that have a pose and so are kept."""
        mount = self._sweeps.mount
        if mount is None or sweep.offset_ns is None:
            return sweep.points_lidar, np.ones(len(sweep.rows), np.bool_)
        is_kept = _has_pose(sweep.offset_ns, mount, stamp_ns)
        points_lidar = sweep.points_lidar[is_kept]
        return deskew(points_lidar, sweep.offset_ns[is_kept], mount, stamp_ns), is_kept


def checked_samples(path: Path, sequence: Sequence) -> BagSamples:
    """Return the samples of the recording at `path`, which is read whole to verify its hash.

    Raises RecordingChangedError, and the errors of opening the bag.
    """
    sha256 = recording_sha256(path)
    if sha256 not in sequence.inputs.values():
        raise Refused(
            "recording_changed",
            f"{path} has sha256 {sha256}, but sequence {sequence.name} was made from {dict(sequence.inputs)}; "
            "label the sequence again, or give the recording of these labels",
        )
    return BagSamples(path, sequence)


def _has_pose(offset_ns: NDArray[np.int64], mount: SweepMount, stamp_ns: int) -> NDArray[np.bool_]:
    """Return a mask of the points that `deskew` keeps."""
    if not len(offset_ns):
        return np.zeros(0, np.bool_)
    motion = sweep_motion(mount, stamp_ns, (int(offset_ns.min()), int(offset_ns.max())))
    bins = (offset_ns + BIN_NS // 2) // BIN_NS - motion.first_bin
    return np.asarray(motion.has_pose[bins], np.bool_)


def _intensity(points: NDArray[np.void], rows: NDArray[np.int32]) -> NDArray[np.float32]:
    for name in INTENSITY_NAMES:
        if name in (points.dtype.names or ()) and points.dtype[name].kind in "fiu":
            values = np.asarray(points[name][rows], np.float32)
            return np.where(np.isfinite(values), values, np.float32(0))
    return np.zeros(len(rows), np.float32)


def jpeg_of(content: bytes) -> tuple[bytes, tuple[int, int]]:
    """Return a JPEG or PNG file as JPEG, encoded like pictures of recordings, and its width and height.

    Raises `PictureError`.
    """
    head = head_of(content, COMPRESSED)
    picture = CameraPicture(COMPRESSED, 0, "", head.width_px, head.height_px, head.kind, 0, False, memoryview(content))
    return as_jpeg(picture), (head.width_px, head.height_px)


def as_jpeg(picture: CameraPicture) -> bytes:
    """Return the recorded bytes if they are JPEG, else encode them once. Raises `PictureError`."""
    if picture.encoding == "JPEG":
        check_end(picture.data, picture.type_name)
        return bytes(picture.data)
    file = io.BytesIO()
    Image.fromarray(picture.pixels()).save(file, "JPEG", quality=JPEG_QUALITY, subsampling=0)
    return file.getvalue()
