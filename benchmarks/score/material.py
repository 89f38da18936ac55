"""Inputs of the scoring benchmark: `DISTINCT` frames repeated, their ground truth in files and a pack.

**Conventions.** Frame k of the submission is frame k modulo `DISTINCT` of the drive. The mask is the LiDAR's. At
another grid than the paper's a frame is its corner of the grid's shape.
"""

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.grids import frames, seen_by_lidar
from services.eval.truth_pack import write_truth_pack
from stone.labels.grid import Grid
from stone.scoring.bitplanes import truth_planes
from stone.scoring.frame_counts import TruthPlanes
from stone_base.label_grid import PAPER, LabelGrid
from stone_files.npz import npz_bytes
from stone_submissions.manifest import Manifest

DISTINCT = 200


@dataclass(frozen=True, eq=False)
class Material:
    """`folder` contains submission.zip, truth.pack and <k>.npz, the label files; `planes` are all in memory."""

    folder: Path
    tokens: tuple[str, ...]
    planes: tuple[TruthPlanes, ...]
    grid: LabelGrid = PAPER

    @property
    def zip_path(self) -> Path:
        return self.folder / "submission.zip"

    @property
    def pack_path(self) -> Path:
        return self.folder / "truth.pack"

    def index_of(self, token: str) -> int:
        return int(token, 16) % len(self.planes)

    def planes_of(self, token: str) -> TruthPlanes:
        return self.planes[self.index_of(token)]

    def label_path(self, token: str) -> Path:
        return self.folder / f"{self.index_of(token)}.npz"


def token_of(index: int) -> str:
    return f"{index:032x}"


def saved_by_numpy(grid: Grid) -> bytes:
    """Return the file of `np.savez_compressed`, which most participants use."""
    file = io.BytesIO()
    np.savez_compressed(file, semantics=grid)
    return file.getvalue()


def material(folder: Path, frame_count: int, grid: LabelGrid = PAPER) -> Material:
    """Create the inputs in this folder, with `frame_count` frames of the grid."""
    planes, files, corner = [], [], tuple(slice(side) for side in grid.shape)
    for index, pair in enumerate(frames(min(DISTINCT, frame_count))):
        truth, prediction = (np.ascontiguousarray(grid_array[corner]) for grid_array in pair)
        mask = seen_by_lidar(truth)
        labels = {"semantics": truth, "mask_lidar": mask, "mask_camera": mask}
        (folder / f"{index}.npz").write_bytes(npz_bytes(labels))
        planes.append(truth_planes(truth, mask != 0, grid))
        files.append(saved_by_numpy(prediction))
    made = Material(folder, tuple(map(token_of, range(frame_count))), tuple(planes), grid)
    with zipfile.ZipFile(made.zip_path, "w") as archive:
        for index, token in enumerate(made.tokens):
            archive.writestr(f"{token}.npz", files[index % len(files)])
    write_truth_pack(made.pack_path, Manifest({"drive": made.tokens}, grid), made.planes_of)
    return made
