"""The label set in a folder of `stone label`, or in an unpacked tar of a dataset version: labels without sensor data.

**Conventions.** Stamps and poses come from `scene/scene.json`, to 0.1 mm. Without it frames are in the order of their
tokens, and have no poses. Labels of a further grid are in `grids/<name>/`.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from stone.geometry.se3 import SE3
from stone_base.errors import Refused
from stone_base.label_grid import LabelGrid
from stone_client.devkit.frame import Frame, LabelFormat
from stone_datasets.classes import OWN_CLASSES
from stone_datasets.labels import layout_of_labels
from stone_exports.files import ExportFileSpan
from stone_exports.frames import ExportedFrame
from stone_files.dataset_layouts import LAYOUTS, plain_token
from stone_files.grid_file import GRID_FILE, read_grid_file

LABELS, GRIDS, SCENE = "gts", "grids", "scene/scene.json"


@dataclass(frozen=True, eq=False)
class LabelSet:
    """Frame tokens by sequence; `stamps_ns` and `poses` by token, if they are known."""

    folder: Path
    format: LabelFormat
    frames: Mapping[str, tuple[str, ...]]
    stamps_ns: Mapping[str, int] = field(default_factory=dict, repr=False)
    poses: Mapping[str, tuple[float, ...]] = field(default_factory=dict, repr=False)
    splits: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def sequences(self) -> tuple[str, ...]:
        """The names of the sequences."""
        return tuple(self.frames)

    def tokens(self, sequence: str) -> tuple[str, ...]:
        """Return the frame tokens of a sequence."""
        return self.frames[sequence]

    @property
    def drives(self) -> tuple[tuple[str, ...], ...]:
        """Each sequence is a drive of its own: a label set does not state which sequences continue each other."""
        return tuple((name,) for name in self.frames)

    def frame(self, sequence: str, at: int) -> Frame:
        """Return the frame at this index of a sequence."""
        token = self.frames[sequence][at]
        name = f"{LABELS}/{sequence}/{token}/labels.npz"
        span = ExportFileSpan(self.folder / name, name, 0, (self.folder / name).stat().st_size)
        stamp_ns, pose = self.stamps_ns.get(token, 0), self.poses.get(token)
        matrix = None if pose is None else SE3(np.array([*pose[3:], *pose[:3]])).as_matrix()
        return Frame(ExportedFrame(token, sequence, stamp_ns // 1000, {}, span), stamp_ns, matrix, self.format)


def is_label_set(path: Path) -> bool:
    """Return whether a folder has labels, and no tables beside them."""
    return (path / LABELS).is_dir() and not any(path.glob("v1.0-*/")) and not (path / "annotations.json").exists()


def read_label_set(path: Path, grid: LabelGrid | None = None) -> LabelSet:
    """Return the label set in a folder, at `grid` if it has several grids. Raises `not_labels`, `bad_grid`."""
    folder = _folder_of(path, grid)
    tokens = dict[str, tuple[str, ...]]()
    for sequence in sorted(entry for entry in (folder / LABELS).iterdir() if entry.is_dir()):
        names = tuple(sorted(entry.name for entry in sequence.iterdir() if plain_token(entry.name) == entry.name))
        tokens |= {sequence.name: names} if names else {}
    if not tokens:
        raise Refused("not_labels", f"{folder} has no {LABELS}/<sequence>/<frame_token>/labels.npz")
    layout = LAYOUTS["paper"].with_grid(grid or _grid_at(folder, tokens))
    found_set = LabelSet(folder, LabelFormat(layout, OWN_CLASSES), tokens)
    scene = next((entry / SCENE for entry in (folder, path) if (entry / SCENE).is_file()), None)
    return found_set if scene is None else _placed(found_set, json.loads(scene.read_text("utf-8")))


def _folder_of(path: Path, grid: LabelGrid | None) -> Path:
    if grid is None or _stated(path) in (None, grid):
        return path
    folders = [folder for folder in sorted(path.glob(f"{GRIDS}/*/")) if _stated(folder) == grid]
    if not folders:
        raise Refused("not_labels", f"{path} has no labels at the grid {grid}; label again with --grid {grid.name}")
    return folders[0]


def _stated(path: Path) -> LabelGrid | None:
    return read_grid_file(path / GRID_FILE) if (path / GRID_FILE).is_file() else None


def _grid_at(folder: Path, tokens: Mapping[str, tuple[str, ...]]) -> LabelGrid:
    """Return the grid of `grid.json`, else the known grid with the shape of the first label file."""
    sequence, (first, *_) = next(iter(tokens.items()))
    path = folder / LABELS / sequence / first / "labels.npz"
    span = ExportFileSpan(path, path.name, 0, path.stat().st_size)
    return _stated(folder) or layout_of_labels(span, has_dashes=False).grid


def _placed(label_set: LabelSet, scene: Mapping[str, Any]) -> LabelSet:
    """Return the label set with its frames in the order of their stamps, and their poses."""
    frames = scene["frames"]
    stamps_ns = dict(zip(frames["tokens"], map(int, frames["stamps_ns"]), strict=True))
    poses = dict(zip(frames["tokens"], map(tuple, frames["map_from_ego"]), strict=True))
    tokens = {
        name: tuple(sorted(own, key=lambda token: (stamps_ns.get(token, 0), token)))
        for name, own in label_set.frames.items()
    }
    return replace(label_set, frames=tokens, stamps_ns=stamps_ns, poses=poses)
