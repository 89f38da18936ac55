"""The work of a sandboxed child for an export: it opens the files located by the parent, and writes the format's files.

**Conventions.** The child writes to `files` in its folder, makes no links, and reads only the files listed here: for a
phase's input, no label, mesh or report is listed. It reports the hashes of the recordings that it needs; imported
labels need none (`services/domain/sequences/label_sources.py`).
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from services.domain.benchmarks.phases.unordered_frames import UnorderedFrames
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.labeler.exports.dataset_source import DatasetSource, DatasetSourceFiles
from services.labeler.exports.errors import damaged_labels
from services.labeler.exports.nuscenes.layout import blank_mask, write_mask
from services.labeler.exports.nuscenes.plan import NuscenesPlan, channels_of
from services.labeler.exports.nuscenes.samples import write_samples
from services.labeler.exports.registry import exporter_of
from services.labeler.exports.source import MESH, REPORT, TABLE, LabelledSequence
from services.labeler.exports.unordered_samples import without_order
from services.labeler.run import Step
from services.runtime.sandbox import ProgressCallback
from services.runtime.sandbox.answers import Hex256, SandboxAnswer
from stone.geometry.se3 import SE3
from stone.sensors.deskew import SweepMount
from stone.sensors.radar_motion import RadarMotion, compensated, radar_motion
from stone.sensors.samples import CameraSample, LidarSample, RadarSample, SampleSource
from stone.sensors.sequence import Sequence
from stone_exports.cameras import MOST_PICTURE_BYTES
from stone_exports.files import ExportFileSpan
from stone_exports.frames import LIDAR_CHANNEL
from stone_exports.labels import FARTHEST_DETECTION_M, WANTED, scan_records
from stone_exports.sweeps import COLUMNS, FARTHEST_RETURN_M, MOST_SWEEP_BYTES
from stone_exports.tables import table_rows, table_span
from stone_files.dataset_layouts import plain_token
from stone_recordings.sync.samples import BagSamples, jpeg_of
from stone_recordings.sync.sequence_file import read_sequence

FILES = "files"
MOST_INPUTS = 1000
UNASKED = "a format that declares no samples reads a sample"


class SourceAnswer(SandboxAnswer):
    """The hashes of a sequence's inputs."""

    expected: ClassVar[str] = "the inputs of a sequence"
    sha256s: Annotated[list[Hex256], Field(max_length=MOST_INPUTS)]


@dataclass(frozen=True)
class LabelRange:
    """The labels of a frame: a range of a pack, and its hash."""

    token: str
    pack: str
    offset_bytes: int
    length_bytes: int
    sha256: str


@dataclass(frozen=True)
class PackedLabels:
    """The labels of frames as ranges of packs on this machine; a value that can be passed to a child."""

    packs: Mapping[str, Path]
    ranges: tuple[LabelRange, ...]

    def __call__(self, index: int) -> bytes:
        """Return the label file. Raises `damaged_labels`."""
        at = self.ranges[index]
        with self.packs[at.pack].open("rb") as file:
            file.seek(at.offset_bytes)
            payload = file.read(at.length_bytes)
        if sha256(payload).hexdigest() != at.sha256:
            raise damaged_labels(Path(at.token) / "labels.npz", "its sha256 differs")
        return payload


@dataclass(frozen=True)
class ExportInputs:
    """The inputs of an export: a folder with the sequence's files by name, its labels, and its sensor data.

    Sensor data are the `recording`, or the `source` of imported labels. Inputs that the format does not need are None.
    """

    folder: Path
    labels: PackedLabels
    recording: Path | None = None
    source: DatasetSource | None = None

    def sequence(self) -> Sequence:
        return read_sequence((self.folder / SEQUENCE_FILE).read_bytes())

    def opened(self) -> LabelledSequence:
        """Return the labelled sequence."""
        sequence = self.sequence()
        report = json.loads((self.folder / REPORT).read_text("utf-8"))
        samples, published = self.samples(sequence), self.source.opened() if self.source else None
        files = (self.folder / MESH, self.folder / TABLE)
        return LabelledSequence(sequence, samples, self.labels, report, *files, published)

    def samples(self, sequence: Sequence) -> SampleSource:
        if self.source is not None:
            return DatasetSamples(self.source, sequence)
        return NoSamples() if self.recording is None else BagSamples(self.recording, sequence)


class NoSamples:
    """Samples of a format that declares to read none; access raises ValueError."""

    def lidar(self, index: int) -> LidarSample:
        raise ValueError(UNASKED)

    def camera(self, channel: str, index: int) -> CameraSample | None:
        raise ValueError(UNASKED)

    def radar(self, channel: str, index: int) -> RadarSample | None:
        raise ValueError(UNASKED)


def source_of(inputs: ExportInputs, _folder: Path, _progress: ProgressCallback) -> bytes:
    """Return the hashes of the recordings from which the sequence was made."""
    return SourceAnswer(sha256s=sorted(set(inputs.sequence().inputs.values()))).packed()


def write_format(name: str, inputs: ExportInputs, folder: Path, progress: ProgressCallback) -> bytes:
    """Write the files of the format with this name. Raises what its exporter raises."""
    exporter_of(name)(inputs.opened(), folder / FILES, partial(progress, name))
    return b""


def write_phase_input(
    inputs: ExportInputs, unordered: UnorderedFrames | None, folder: Path, progress: ProgressCallback
) -> bytes:
    """Write the files of a phase's input: sensor data only."""
    sequence = inputs.sequence()
    samples = inputs.samples(sequence)
    if unordered is not None:
        sequence, samples = without_order(sequence, samples, unordered.of(sequence.frames.tokens))
    write_sensed(sequence, samples, folder / FILES, partial(progress, "inputs"), is_ordered=unordered is None)
    return b""


# Exports for participants: the sensor data of a sequence without anything derived from its labels. They have the
# release layout (`services/labeler/exports/nuscenes/samples.py`), so readers of train also read test. They are made
# only from the synchronised sequence and its recording, so no number can come from a label. The map is shifted by the
# robot's track. The mask, which the devkit requires, is black.


def write_inputs(source: LabelledSequence, out: Path, step: Step) -> None:
    """Write the input; uses only sequence and samples of the labelled sequence."""
    write_sensed(source.sequence, source.samples, out, step)


def write_sensed(sequence: Sequence, samples: SampleSource, out: Path, step: Step, *, is_ordered: bool = True) -> None:
    """Write the sequence into the empty folder `out`. Raises what `write_samples` raises."""
    mask = blank_mask(sequence.frames.map_from_ego.translation_m[:, :2])
    plan = NuscenesPlan(sequence, channels_of(sequence), mask.low_m, is_ordered=is_ordered)
    (out / "maps").mkdir()
    write_mask(out / plan.mask_filename, mask)
    total = len(sequence.frames)
    write_samples(samples, plan, out, lambda index: step(index + 1, total))


# Samples of each sensor for a frame, read from the files of a published dataset. The datum of a frame is its key frame
# in `sample_data`; radars are the inverse of `services/labeler/exports/nuscenes/samples.py`. JPEG pictures are kept,
# others are encoded like those of recordings. Sweep rows without a valid position near the sensor, and detections
# marked invalid, are dropped. Times are the sequence's.


LAST_RING = np.iinfo(np.uint16).max
VALID_STATE = 0
MEASURED = ("vx", "vy")
Records = NDArray[np.void]
Rates = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class DatasetSamples:
    """A SampleSource over an imported scene and its sequence. Picklable: it contains only paths.

    Reading raises `DamagedExportError` if a file does not fit its sensor.
    """

    source: DatasetSource
    sequence: Sequence

    def lidar(self, index: int) -> LidarSample:
        """Return the sweep of frame `index`; empty if the dataset has no LiDAR."""
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
        """Return the file of the frame's datum; None if the channel has none. Raises `DamagedExportError`."""
        filename = self._filenames.get((self.sequence.frames.tokens[index], channel))
        if filename is None:
            return None
        span = self._files.span(filename)
        if span is None:
            raise table_span(self._files, "sample_data").damaged(
                f"it refers to {filename[:200]!r}, which does not exist"
            )
        return span

    def _taken_ns(self, channel: str, index: int) -> int:
        frames = self.sequence.frames
        return int(frames.stamps_ns[index]) + int(frames.associations[channel].dt_ns[index])

    @cached_property
    def _files(self) -> DatasetSourceFiles:
        return self.source.opened()

    @cached_property
    def _filenames(self) -> Mapping[tuple[str, str], str]:
        """The file names of key-frame data, by frame token and channel."""
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
    """Return the file of each key-frame datum by its frame's token, without dashes, and its channel.

    Raises `DamagedExportError`.
    """
    channels = {str(row.get("token")): str(row.get("channel")) for row in table_rows(files, "sensor")}
    mounts = table_rows(files, "calibrated_sensor")
    mounted = {str(row.get("token")): channels.get(str(row.get("sensor_token"))) for row in mounts}
    files_by_key = dict[tuple[str, str], str]()
    for row in table_rows(files, "sample_data"):
        channel = mounted.get(str(row.get("calibrated_sensor_token")))
        if channel is not None and row.get("is_key_frame") is True:
            written = str(row.get("sample_token"))
            files_by_key[plain_token(written) or written, channel] = str(row.get("filename"))
    return files_by_key


def lidar_sample(span: ExportFileSpan) -> LidarSample:
    """Return the sweep in a `.pcd.bin`: rows of x y z intensity ring, float32. Raises `DamagedExportError`."""
    content = span.read(MOST_SWEEP_BYTES)
    if len(content) % (COLUMNS * 4):
        raise span.damaged(f"its {len(content)} bytes are not rows of {COLUMNS} float32")
    rows = np.frombuffer(content, "<f4").reshape(-1, COLUMNS)
    rows = rows[(np.abs(rows[:, :3]) < FARTHEST_RETURN_M).all(axis=1) & (rows[:, :3] != 0).any(axis=1)]
    measured = np.where(np.isfinite(rows[:, 3:]), rows[:, 3:], np.float32(0))
    points_lidar = np.ascontiguousarray(rows[:, :3], np.float32)
    return LidarSample(points_lidar, measured[:, 0], measured[:, 1].clip(0, LAST_RING).astype(np.uint16))


def radar_sample(span: ExportFileSpan, taken_ns: int, motion: RadarMotion) -> RadarSample:
    """Return the scan in a binary PCD of a radar with this motion. Raises `DamagedExportError`."""
    records = _valid_detections(scan_records(span))
    points = _columns(records, WANTED[:3])
    ground_rate_m_s = _rates(points, _columns(records, ("vx_comp", "vy_comp")))
    own = compensated(points, np.zeros(len(points)), motion)
    if set(MEASURED) <= set(records.dtype.names or ()):
        range_rate_m_s = _rates(points, _columns(records, MEASURED))
    else:
        range_rate_m_s = ground_rate_m_s - own.ground_rate_m_s
    rcs_db = records["rcs"].astype(np.float32)
    return RadarSample(taken_ns, points, own.points_lidar, range_rate_m_s, ground_rate_m_s, rcs_db)


def _valid_detections(records: Records) -> Records:
    """Return the valid detections that have a position and a motion near the sensor."""
    names = records.dtype.names or ()
    measured = _columns(records, (*WANTED, *(name for name in MEASURED if name in names)))
    is_near = np.asarray((np.abs(measured) < FARTHEST_DETECTION_M).all(axis=1))
    is_kept = is_near & (np.linalg.norm(np.where(is_near[:, None], measured[:, :3], 0), axis=1) > 0)
    if "invalid_state" in names:
        is_kept &= records["invalid_state"] == VALID_STATE
    kept: Records = records[is_kept]
    return kept


def _rates(points_radar: Rates, velocities_m_s: Rates) -> Rates:
    """Return the rates along the ray (N,) of plan velocities (N, 2); 0 directly above or below the radar.

    The inverse of `towards * rate`, in which a plan velocity is the x and y component of one rate.
    """
    towards = points_radar[:, :2] / np.linalg.norm(points_radar, axis=1)[:, None]
    square = (towards**2).sum(axis=1)
    rates: Rates = (velocities_m_s * towards).sum(axis=1) / np.where(square > 0, square, np.inf)
    return rates


def _columns(records: Records, names: tuple[str, ...]) -> NDArray[np.float64]:
    with np.errstate(invalid="ignore"):  # widening a signalling NaN raises a warning
        columns: Any = [records[name].astype(np.float64) for name in names]
    return np.stack(columns, axis=1)
