"""A bag of the release beside a ZIP with labels that our labeler made of it, with any settings.

**Conventions.** The dataset has the stamps, exact poses and LiDAR of the bag, so its ego origin is above the ground, by
`ego_height_m` of the bag. Labels are cut around the origin that ground auto places on the ground, by the release's
grid, raised by the same height. Voxels that no ray reached are unknown.
"""

import json
import shutil
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from io import BytesIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import LabelParameters
from simulator.options import SimulateOptions
from simulator.scenery.world import build_world
from stone.geometry.se3 import SE3
from stone.sensors.sequence import Sequence
from stone_base.label_grid import RELEASE
from stone_files.npz import npz_bytes
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.sync.sweeps import BagSweeps
from testing.worlds.published_datasets import FIRST_US, STEP_US, VERSION, Row
from testing.worlds.release_bags import RELEASED, release_calibration, write_release_bag
from testing.worlds.released_datasets import ReleasedDataset, released_tables

SCENES, FIRST = 2, 1
"""The number of scenes in the dataset, and the first frame of the bag in it."""
HALF_TURN = SE3.from_parts(np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3))
Grid = NDArray[np.uint8]
Change = Callable[[Grid, NDArray[np.float64]], Grid]
"""Maps released labels and the returns (N, 3) of their frame, in its ego frame, to other labels."""


@dataclass(frozen=True, eq=False)
class MadePair:
    """A bag without calibration, and the labels (F, X, Y, Z) of its frames from `FIRST` on, as the release has them."""

    bag: Path
    options: SimulateOptions
    ego_from_lidar: SE3
    sequence: Sequence
    sweeps: BagSweeps
    labels: NDArray[np.uint8]

    def write_zip(self, path: Path, change: Change | None = None, late_us: int = 0, turned_scenes: int = 0) -> Path:
        """Write tables and labels; stamps are `late_us` later than the bag's.

        In the first `turned_scenes` scenes the LiDAR is turned by half a turn.
        """
        mounts = [self.ego_from_lidar] * SCENES
        mounts[:turned_scenes] = [self.ego_from_lidar @ HALF_TURN] * turned_scenes
        changed = self._changed(late_us, iter(mounts))
        what = ReleasedDataset(SCENES, len(self.labels) // SCENES, cameras=(), changed=changed)
        names = [(name, token) for at, name in enumerate(what.tables.names) for token in what.tables.tokens(at)]
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for table, rows in released_tables(what).items():
                content = json.dumps([changed(table, row) for row in rows])
                archive.writestr(f"{what.root}{VERSION}/{table}.json", content)
            for (scene, token), labels in zip(names, self._written(change), strict=True):
                archive.writestr(f"{what.root}gts/{scene}/{what.written(token)}/labels.npz", labels)
        return path

    def _written(self, change: Change | None) -> Iterator[bytes]:
        for frame, labels in enumerate(self.labels, FIRST):
            returns_ego = self.ego_from_lidar @ self.sweeps.sweep(frame).points_lidar.astype(np.float64)
            yield npz_bytes({"label": labels if change is None else change(labels, returns_ego)})

    @cached_property
    def _poses(self) -> SE3:
        raised = SE3.from_parts(np.array([1.0, 0, 0, 0]), np.array([0.0, 0.0, RELEASED.ego_height_m]))
        return build_world(self.options).trajectory.at(self.sequence.frames.stamps_ns[FIRST:]) @ raised

    def _changed(self, late_us: int, mounts: Iterator[SE3]) -> Callable[[str, Row], Row]:
        stamps_us = (self.sequence.frames.stamps_ns[FIRST:] // 1000).tolist()

        def changed(table: str, row: Row) -> Row:
            if table == "calibrated_sensor":
                return row | _pose_row(next(mounts))
            if "timestamp" not in row:
                return row
            frame = (row["timestamp"] - FIRST_US) // STEP_US
            pose = _pose_row(self._poses[frame]) if table == "ego_pose" else {}
            stamp_us = stamps_us[frame] + late_us
            file = row.get("filename", "").replace(str(row["timestamp"]), str(stamp_us))
            return row | pose | ({"filename": file} if file else {}) | {"timestamp": stamp_us}

        return changed


def make_pair(bag: Path, options: SimulateOptions, parameters: LabelParameters) -> MadePair:
    """Write the bag, and label an even number of its frames by the parameters."""
    write_release_bag(bag, options)
    given, _ = read_calibration(release_calibration(bag))
    synchronised = SynchroniseOptions(ground="auto", is_checked=False)
    sequence, sweeps = open_sequence(bag, release_calibration(bag), "made", synchronised)
    release_calibration(bag).unlink()
    x, y, z = RELEASE.min_m
    lowered_m = float(sequence.calibration.ego_from_lidar.translation_m[2] - given.ego_from_lidar.translation_m[2])
    raised = replace(RELEASE, name="raised", min_m=(x, y, z + lowered_m), unknown=None)
    out = bag.with_name(f"{bag.name}.labels")
    label(sequence, sweeps, out, LabelOptions(replace(parameters, grids=(raised,))))
    count = (len(sequence.frames) - FIRST) // SCENES * SCENES
    tokens = sequence.frames.tokens[FIRST : FIRST + count]
    labels = np.stack([_as_released(out / "gts" / "made" / token) for token in tokens])
    shutil.rmtree(out)
    return MadePair(bag, options, given.ego_from_lidar, sequence, sweeps, labels)


def _as_released(folder: Path) -> Grid:
    with np.load(BytesIO((folder / "labels.npz").read_bytes())) as arrays:
        return np.where(arrays["mask_lidar"] > 0, arrays["semantics"], np.uint8(255)).astype(np.uint8)


def _pose_row(pose: SE3) -> Row:
    return {"rotation": pose.wxyz.tolist(), "translation": pose.translation_m.tolist()}
