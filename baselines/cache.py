"""A cache of frames for training: a safetensors file per frame, so that an epoch reads no tables and undistorts
nothing.

**Conventions.** A file is named `<token>.<16 hex digits>.safetensors`; the digits are a digest of its inputs (including
sizes and times of the files read), so that exactly the changed frames are read again. Files appear by atomic rename: an
interrupted cache continues, and runs may share it. Its metadata contains the sha256 of its content and the voxels of
each class.
"""

import json
import zlib
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from safetensors import safe_open
from safetensors.numpy import load_file, save_file

from baselines.frame_record import ALL_LABELS, STEP_M, FrameRecord, PictureRecord, WantedLabels, read_record
from baselines.inputs import InputConfig
from stone.geometry.se3 import SE3
from stone.scoring.metric import CLASSES
from stone_base.label_grid import PAPER
from stone_exports.files import ExportFileSpan
from stone_exports.frames import ExportedFrame
from stone_exports.labels import UNSURE
from stone_files.atomic import atomic_file

VERSION = 1
SUFFIX = ".safetensors"
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class FrameSource:
    """A frame of an export, the location of its labels (in the export, or a dataset version beside it), and the wanted
    labels.
    """

    frame: ExportedFrame
    labels: ExportFileSpan | None
    wanted: WantedLabels = ALL_LABELS


@dataclass(frozen=True)
class CachedFrame:
    """A file of the cache: `voxels` per class of its labels, the number of `unsure` voxels, `sha256` of its content."""

    path: Path
    token: str
    sequence: str
    stamp_us: int
    voxels: tuple[int, int, int, int]
    sha256: str
    unsure: int = 0

    def read(self) -> FrameRecord:
        """Return the frame."""
        arrays = load_file(self.path)
        labels = arrays.get("labels")
        pictures = tuple(_pictures(arrays))
        returns = arrays["returns"].astype(np.float32)
        returns[:, :3] *= STEP_M
        classes = None if labels is None else _inflated(labels, arrays.get("labels.shape"))
        pose = SE3(arrays["global_from_ego"])
        return FrameRecord(
            self.token, self.sequence, self.stamp_us, pose, returns, arrays["detections"], pictures, classes
        )


@dataclass(frozen=True)
class CachedStore:
    """Cached frames in the form of a dataset."""

    frames: tuple[CachedFrame, ...]

    def __len__(self) -> int:
        return len(self.frames)

    def key(self, index: int) -> tuple[str, int]:
        return self.frames[index].sequence, self.frames[index].stamp_us

    def read(self, index: int) -> FrameRecord:
        return self.frames[index].read()


def cached_frames(
    sources: Iterable[FrameSource], inputs: InputConfig, folder: Path, progress: Progress, workers: int = 2
) -> tuple[CachedFrame, ...]:
    """Return every frame in the cache, in order; missing frames are read and added.

    Raises `DamagedExportError`, `sensor_missing`, `no_confidence`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    wanted = tuple(sources)
    frames = []
    with ThreadPoolExecutor(workers) as pool:
        for done, cached in enumerate(pool.map(partial(_cached, inputs=inputs, folder=folder), wanted), start=1):
            frames.append(cached)
            progress("read frames", done, len(wanted))
    return tuple(frames)


def data_hash(frames: Iterable[CachedFrame]) -> str:
    """Return the sha256 of the network's inputs in these frames."""
    whole = sha256()
    for line in sorted(f"{frame.token} {frame.sequence} {frame.stamp_us} {frame.sha256}" for frame in frames):
        whole.update(line.encode())
    return whole.hexdigest()


def _cached(source: FrameSource, inputs: InputConfig, folder: Path) -> CachedFrame:
    path = folder / f"{source.frame.token}.{_identity(source, inputs)}{SUFFIX}"
    if not path.exists():
        write_record(path, read_record(source.frame, source.labels, inputs, source.wanted))
    return _described(path, source.frame)


def _described(path: Path, frame: ExportedFrame) -> CachedFrame:
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
    counted = [int(count) for count in json.loads(metadata["voxels"])]
    free, t, p, n = counted
    unsure = int(metadata.get("unsure", "0"))
    return CachedFrame(path, frame.token, frame.sequence, frame.stamp_us, (free, t, p, n), metadata["sha256"], unsure)


def write_record(path: Path, record: FrameRecord) -> None:
    """Write the file of a frame, whole or not at all."""
    arrays = _arrays(record)
    whole = sha256()
    for name, array in sorted(arrays.items()):
        whole.update(name.encode() + array.tobytes())
    counts = np.zeros(256, np.int64) if record.labels is None else np.bincount(record.labels.reshape(-1), minlength=256)
    metadata = {"sha256": whole.hexdigest(), "voxels": json.dumps(counts[:CLASSES].tolist())}
    metadata["unsure"] = str(counts[UNSURE])
    with atomic_file(path) as staging:
        save_file(arrays, staging, metadata)


def _arrays(record: FrameRecord) -> dict[str, NDArray[np.generic]]:
    returns = np.rint(record.returns / (STEP_M, STEP_M, STEP_M, 1.0))
    arrays: dict[str, NDArray[np.generic]] = {
        "returns": returns.clip(-32767, 32767).astype(np.int16),
        "detections": np.ascontiguousarray(record.detections, np.float32),
        "global_from_ego": np.ascontiguousarray(record.global_from_ego.wxyz_xyz),
    }
    if record.labels is not None:
        arrays["labels"] = np.frombuffer(zlib.compress(record.labels.tobytes(), 1), np.uint8)
        if record.labels.shape != PAPER.shape:
            arrays["labels.shape"] = np.array(record.labels.shape, np.int64)
    for index, picture in enumerate(record.pictures):
        arrays[f"picture{index}.jpeg"] = np.frombuffer(picture.jpeg, np.uint8)
        arrays[f"picture{index}.intrinsics"] = picture.intrinsics
        arrays[f"picture{index}.ego_from_camera"] = np.ascontiguousarray(picture.ego_from_camera)
    return arrays


def _pictures(arrays: dict[str, NDArray[np.generic]]) -> Iterator[PictureRecord]:
    index = 0
    while f"picture{index}.jpeg" in arrays:
        matrix, mount = arrays[f"picture{index}.intrinsics"], arrays[f"picture{index}.ego_from_camera"]
        yield PictureRecord(
            arrays[f"picture{index}.jpeg"].tobytes(), matrix.astype(np.float64), mount.astype(np.float64)
        )
        index += 1


def _inflated(labels: NDArray[np.uint8], shape: NDArray[np.int64] | None) -> NDArray[np.uint8]:
    sides = PAPER.shape if shape is None else tuple(shape.tolist())
    return np.frombuffer(zlib.decompress(labels.tobytes()), np.uint8).reshape(sides)


def _identity(source: FrameSource, inputs: InputConfig) -> str:
    """Return digits that change with every input of the frame."""
    facts: list[object] = [VERSION, inputs.modality, inputs.image_size_px, inputs.channels, inputs.with_depth]
    spans = [datum.span for _, datum in sorted(source.frame.data.items())]
    facts += [span.identity() for span in (*spans, *(() if source.labels is None else (source.labels,)))]
    for _, datum in sorted(source.frame.data.items()):
        sensor = datum.sensor
        facts.append(
            [datum.stamp_us, datum.global_from_ego.wxyz_xyz.tolist(), sensor.ego_from_sensor.wxyz_xyz.tolist()]
        )
        facts.append(repr(sensor.intrinsics))
    if source.wanted.least_confidence > 0:
        facts.append(["least confidence", source.wanted.least_confidence])
    if source.wanted.grid != PAPER:
        facts.append(source.wanted.grid.as_record())
    return sha256(json.dumps(facts, separators=(",", ":")).encode()).hexdigest()[:16]
