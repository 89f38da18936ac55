"""Synthetic published datasets: any number of scenes and frames in the release's layout, or in Occ3D's.

**Conventions.** Every scene drives the same gentle curve; files of one sensor have the same bytes, hard-linked (or
copied into a tar), so writing 50,000 frames takes minutes. Names follow the release:
`n001-2025-08-22-07-14-16+0900__<CHANNEL>__<µs>.<ending>`.
"""

import io
import json
import os
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from stone.sensors.sequence import frame_token
from stone_base.label_grid import PAPER
from stone_files.npz import npz_bytes
from testing.worlds.small_export import FOCAL_PX, PICTURE_PX, START_US, global_from_ego, picture_of

LOGFILE = "n001-2025-08-22-07-14-16+0900"
FIRST_US, STEP_US, EXPOSURE_US = 1_755_846_856_000_000, 100_000, 20_000
SCENE_US = 10_000_000_000
MOST_LINKS = 50_000  # links to one file; ext4 allows 65,000
ENDINGS = {"lidar": "pcd.bin", "camera": "jpg", "radar": "pcd"}
VERSION = "v1.0-trainval"
MATRIX = [[FOCAL_PX, 0, (PICTURE_PX[0] - 1) / 2], [0, FOCAL_PX, (PICTURE_PX[1] - 1) / 2], [0, 0, 1]]
RADAR = (
    "VERSION 0.7\nFIELDS x y z rcs vx_comp vy_comp\nSIZE 4 4 4 4 4 4\nTYPE F F F F F F\nCOUNT 1 1 1 1 1 1\n"
    "WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA binary\n"
)
Row = dict[str, Any]


@dataclass(frozen=True)
class SyntheticDataset:
    """The dataset to write: scenes of `frames`, the first `longer` of one more.

    Frames use `labels` in turn; without labels it is a test set. After `turns_after` frames the robot drives back and
    forth again, starting each drive elsewhere; 0: without turning. `locations` lie `apart_m` apart. `drive_scenes`
    scenes are chunks of one drive with one log and continuous stamps and poses.
    """

    scenes: int = 2
    frames: int = 3
    longer: int = 0
    cameras: Sequence[str] = ("CAM_FRONT", "CAM_BACK")
    radars: Sequence[str] = ("RADAR_FRONT",)
    labels: Sequence[bytes] = ()
    splits: Mapping[str, Sequence[str]] | None = None
    locations: Sequence[str] = ("field",)
    turns_after: int = 0
    drive_scenes: int = 1
    apart_m: float = 0.0

    @cached_property
    def names(self) -> tuple[str, ...]:
        return tuple(f"field-{scene:04}" for scene in range(self.scenes))

    @cached_property
    def places(self) -> tuple[str, ...]:
        """Its locations, each once."""
        return tuple(dict.fromkeys(self.locations))

    @cached_property
    def sensors(self) -> Mapping[str, str]:
        """Modality by channel."""
        return {"LIDAR_TOP": "lidar"} | dict.fromkeys(self.cameras, "camera") | dict.fromkeys(self.radars, "radar")

    def length(self, scene: int) -> int:
        """Return the number of frames of a scene."""
        return self.frames + (scene < self.longer)

    def stamp_us(self, scene: int, frame: int) -> int:
        first = self.first_of_drive(scene)
        before = (scene - first) * self.frames + min(max(self.longer - first, 0), scene - first)
        return FIRST_US + scene // self.drive_scenes * SCENE_US + (before + frame) * STEP_US

    def first_of_drive(self, scene: int) -> int:
        """Return the first scene of the drive that contains a scene."""
        return scene // self.drive_scenes * self.drive_scenes

    def location(self, scene: int) -> str:
        return self.locations[min(scene, len(self.locations) - 1)]

    def tokens(self, scene: int) -> tuple[str, ...]:
        stamps_us = (self.stamp_us(scene, frame) for frame in range(self.length(scene)))
        return tuple(frame_token(self.names[scene], stamp_us * 1000) for stamp_us in stamps_us)

    def filename(self, channel: str, stamp_us: int) -> str:
        return f"samples/{channel}/{LOGFILE}__{channel}__{stamp_us}.{ENDINGS[self.sensors[channel]]}"

    def datum_us(self, scene: int, frame: int, channel: str) -> int:
        return self.stamp_us(scene, frame) + (0 if channel == "LIDAR_TOP" else EXPOSURE_US)


def made_labels(seed: int = 0, highest: int = 3) -> bytes:
    """Return a frame of flat ground of all classes, observed below a metre."""
    semantics, seen = np.zeros(PAPER.shape, np.uint8), np.zeros(PAPER.shape, np.uint8)
    semantics[:, :, 9] = np.random.default_rng(seed).integers(0, highest + 1, (8, 8)).repeat(32, 0).repeat(32, 1)
    seen[:, :, :15] = 1
    return npz_bytes({"semantics": semantics, "mask_lidar": seen, "mask_camera": seen})


def write_published(folder: Path, what: SyntheticDataset) -> Path:
    """Write the release's layout into the folder."""
    for name in (VERSION, "gts", *(f"samples/{channel}" for channel in what.sensors)):
        (folder / name).mkdir(parents=True)
    for table, rows in tables_of(what).items():
        _write_rows(folder / VERSION / f"{table}.json", rows)
    first: dict[tuple[int, int], Path] = {}
    for number, (name, content) in enumerate(_files(what)):
        path, same = folder / name, (id(content), number // MOST_LINKS)
        if name.startswith("gts/"):
            path.parent.mkdir(parents=True)
        if same in first:
            os.link(first[same], path)
        else:
            path.write_bytes(content)
            first[same] = path
    if what.splits is not None:
        (folder / "splits.json").write_text(json.dumps(what.splits))
    return folder


def write_published_tar(path: Path, what: SyntheticDataset, root: str = "") -> Path:
    """Write the same layout into a tar, below `root`."""
    with tarfile.open(path, "w") as tar:
        for table, rows in tables_of(what).items():
            text = "[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n"
            _add(tar, f"{root}{VERSION}/{table}.json", text.encode())
        for name, content in _files(what):
            _add(tar, f"{root}{name}", content)
        if what.splits is not None:
            _add(tar, f"{root}splits.json", json.dumps(what.splits).encode())
    return path


def write_annotated(folder: Path, what: SyntheticDataset) -> Path:
    """Write Occ3D's layout: pictures in imgs/, labels, annotations.json."""
    infos: dict[str, dict[str, Row]] = {}
    for scene, name in enumerate(what.names):
        tokens = what.tokens(scene)
        infos[name] = {token: _annotated(what, (scene, frame), tokens) for frame, token in enumerate(tokens)}
    splits = {f"{split}_split": list(names) for split, names in (what.splits or {}).items()}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "annotations.json").write_text(json.dumps({**splits, "scene_infos": infos}, indent=2))
    for name, content in _files(what):
        if not name.startswith("samples/LIDAR") and not name.startswith("samples/RADAR"):
            path = folder / name.replace("samples/", "imgs/")
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return folder


def tables_of(what: SyntheticDataset) -> Mapping[str, Iterator[Row]]:
    """Return the rows of every required table, computed lazily."""
    return {
        "sensor": (
            {"token": _of("sensor", channel), "channel": channel, "modality": kind}
            for channel, kind in what.sensors.items()
        ),
        "calibrated_sensor": (_mount(what, name, channel) for name in what.names for channel in what.sensors),
        "log": (
            {"token": _of("log", name), "logfile": LOGFILE, "vehicle": "rover", "location": what.location(scene)}
            for scene, name in enumerate(what.names)
            if scene % what.drive_scenes == 0
        ),
        "scene": (_scene(what, scene) for scene in range(what.scenes)),
        "sample": (row for scene in range(what.scenes) for row in _samples(what, scene)),
        "ego_pose": (row for scene in range(what.scenes) for row in _poses(what, scene)),
        "sample_data": (row for scene in range(what.scenes) for row in _data(what, scene)),
        "category": iter([{"token": _of("category", "free"), "name": "free", "index": 0}]),
    }


def _of(kind: str, *facts: object) -> str:
    return sha256(repr((kind, *facts)).encode()).hexdigest()[:32]


def _mount(what: SyntheticDataset, name: str, channel: str) -> Row:
    is_camera = what.sensors[channel] == "camera"
    row: Row = {
        "token": _of("mount", name, channel),
        "sensor_token": _of("sensor", channel),
        "translation": [0.1, -0.2, 1.0],
        "rotation": [0.5, -0.5, 0.5, -0.5] if is_camera else [1.0, 0.0, 0.0, 0.0],
        "camera_intrinsic": MATRIX if is_camera else [],
    }
    lens = {"camera_model": "plumb_bob", "camera_distortion": [-0.05, 0.01, 0, 0, 0]} if is_camera else {}
    return row | lens


def _scene(what: SyntheticDataset, scene: int) -> Row:
    tokens, name = what.tokens(scene), what.names[scene]
    return {
        "token": _of("scene", name),
        "log_token": _of("log", what.names[what.first_of_drive(scene)]),
        "nbr_samples": what.length(scene),
        "first_sample_token": tokens[0],
        "last_sample_token": tokens[-1],
        "name": name,
        "description": "",
    }


def _samples(what: SyntheticDataset, scene: int) -> Iterator[Row]:
    tokens = ("", *what.tokens(scene), "")
    for frame in range(what.length(scene)):
        yield {
            "token": tokens[frame + 1],
            "timestamp": what.stamp_us(scene, frame),
            "prev": tokens[frame],
            "next": tokens[frame + 2],
            "scene_token": _of("scene", what.names[scene]),
        }


def _poses(what: SyntheticDataset, scene: int) -> Iterator[Row]:
    for frame in range(what.length(scene)):
        for channel in what.sensors:
            stamp_us = what.datum_us(scene, frame, channel)
            token = _of("datum", scene, frame, channel)
            yield {"token": token, "timestamp": stamp_us, **pose_of(what, scene, stamp_us)}


def pose_of(what: SyntheticDataset, scene: int, stamp_us: int) -> Row:
    """Return `rotation` and `translation` of the robot at a stamp."""
    first, turn_us = what.first_of_drive(scene), what.turns_after * STEP_US
    moved_us = stamp_us - what.stamp_us(first, 0)
    if turn_us:
        moved_us = turn_us - abs((moved_us + first * STEP_US) % (2 * turn_us) - turn_us)
    rotation, (x, y, z) = _track(moved_us)
    x += what.apart_m * what.places.index(what.location(first))
    return {"rotation": list(rotation), "translation": [x, y, z]}


@lru_cache(10_000)
def _track(moved_us: int) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the rotation and the translation this long after the start of a drive."""
    pose = global_from_ego(START_US + moved_us)
    return tuple(pose.wxyz.tolist()), tuple(pose.translation_m.tolist())


def _data(what: SyntheticDataset, scene: int) -> Iterator[Row]:
    tokens, width_px, height_px = what.tokens(scene), *PICTURE_PX
    for frame, token in enumerate(tokens):
        for channel, modality in what.sensors.items():
            stamp_us, own = what.datum_us(scene, frame, channel), _of("datum", scene, frame, channel)
            yield {
                "token": own,
                "sample_token": token,
                "ego_pose_token": own,
                "calibrated_sensor_token": _of("mount", what.names[scene], channel),
                "timestamp": stamp_us,
                "fileformat": "jpg" if modality == "camera" else "pcd",
                "is_key_frame": True,
                "height": height_px if modality == "camera" else 0,
                "width": width_px if modality == "camera" else 0,
                "filename": what.filename(channel, stamp_us),
                "prev": _of("datum", scene, frame - 1, channel) if frame else "",
                "next": _of("datum", scene, frame + 1, channel) if frame + 1 < len(tokens) else "",
            }


def _annotated(what: SyntheticDataset, of: tuple[int, int], tokens: Sequence[str]) -> Row:
    (scene, frame), ends = of, ("", *tokens, "")
    stamp_us = what.stamp_us(scene, frame)
    mount = {"translation": [0.1, -0.2, 1.0], "rotation": [0.5, -0.5, 0.5, -0.5]}
    taken_us = stamp_us + EXPOSURE_US
    return {
        "timestamp": str(stamp_us),
        "camera_sensor": {
            _of("datum", scene, frame, channel): {
                "img_path": what.filename(channel, taken_us).replace("samples/", "imgs/"),
                "intrinsic": MATRIX,
                "extrinsic": mount,
                "ego_pose": pose_of(what, scene, taken_us),
            }
            for channel in what.cameras
        },
        "ego_pose": pose_of(what, scene, stamp_us),
        "gt_path": f"gts/{what.names[scene]}/{tokens[frame]}/labels.npz",
        "prev": ends[frame],
        "next": ends[frame + 2],
    }


def _files(what: SyntheticDataset) -> Iterator[tuple[str, bytes]]:
    """Yield names with contents; equal contents are one object."""
    sweep = np.linspace(-20, 20, 50, dtype="<f4").tobytes()
    scan = RADAR.encode() + np.arange(12, dtype="<f4").tobytes()
    contents = {"lidar": sweep, "camera": picture_of(FIRST_US, "CAM"), "radar": scan}
    for scene, name in enumerate(what.names):
        for frame, token in enumerate(what.tokens(scene)):
            for channel, modality in what.sensors.items():
                yield what.filename(channel, what.datum_us(scene, frame, channel)), contents[modality]
            if what.labels:
                yield f"gts/{name}/{token}/labels.npz", what.labels[frame % len(what.labels)]


def _write_rows(path: Path, rows: Iterator[Row]) -> None:
    """Write a row per line, as exports do."""
    with path.open("w") as file:
        for number, row in enumerate(rows):
            file.write(("[\n" if not number else ",\n") + json.dumps(row))
        file.write("\n]\n")


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(content)
    tar.addfile(member, io.BytesIO(content))
