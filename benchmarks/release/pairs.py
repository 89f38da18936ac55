"""The released data in a folder: the dataset, its bags, and each bag's frames with released labels.

**Conventions.** A frame of a bag and one of the dataset are the same if their stamps are at most `MOST_OFF_NS` apart.
The released labels are cut around the ego origin of the released tables, ours with the origin on the ground.
`ours_from_theirs` maps one ego frame to the other, since both have the LiDAR at the same place.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import sequence_in
from simulator.pipeline import write_calibration
from stone.errors import Refused
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.sequence import Frames, Sequence, SweepSource
from stone_base.label_grid import LabelGrid
from stone_datasets.index import DatasetIndex, DatasetSequence
from stone_datasets.reading import read_dataset
from stone_exports.files import ExportFileSpan
from stone_exports.frames import LIDAR_CHANNEL
from stone_files.dataset_faults import DatasetFaultError
from stone_files.dataset_layouts import DatasetLayout
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.calibrations.recording_rig import is_recording

MOST_OFF_NS, MARGIN_NS = 5_000_000, 1_000_000_000
NO_DATASET = "DST-001"


@dataclass(frozen=True, eq=False)
class ReleasedPair:
    """A bag and the released labels of M of its frames.

    `rows` (M,) are those frames, `labels` their files, `off_ns` (M,) how much later the dataset's stamps are, `apart_m`
    (M,) the distance of both LiDAR positions. The ego origin of `sequence` is on the ground.
    """

    name: str
    sequence: Sequence
    sweeps: SweepSource
    layout: DatasetLayout
    their_ego_from_lidar: SE3
    rows: NDArray[np.int64]
    labels: tuple[ExportFileSpan, ...]
    off_ns: NDArray[np.int64]
    apart_m: NDArray[np.float64]

    @cached_property
    def ours_from_theirs(self) -> SE3:
        """Our ego frame from the ego frame of the released tables."""
        return self.sequence.calibration.ego_from_lidar @ self.their_ego_from_lidar.inverse()

    @property
    def reach(self) -> LabelGrid:
        """The grid of the released labels in our ego frame, which the map has to cover."""
        low = np.array(self.layout.grid.min_m) + self.ours_from_theirs.translation_m
        x, y, z = low.tolist()
        return replace(self.layout.grid, name="released", min_m=(x, y, z))

    @cached_property
    def compared(self) -> Sequence:
        """The frames with released labels, at the poses of the released ego origin."""
        frames = self.sequence.frames
        tokens = tuple(frames.tokens[row] for row in self.rows.tolist())
        poses = frames.map_from_ego[self.rows] @ self.ours_from_theirs
        return replace(self.sequence, frames=Frames(frames.stamps_ns[self.rows], tokens, poses))


def dataset_in(folder: Path) -> DatasetIndex:
    """Return the dataset of a folder: a ZIP or tar in it, or unpacked. Raises `no_release`, a `DatasetFaultError`."""
    if not folder.is_dir():
        raise Refused("no_release", f"{folder} is not an existing folder (is the path right?)")
    archives = (file for file in sorted(folder.iterdir()) if file.suffix in (".zip", ".tar"))
    for path in (*archives, folder):
        try:
            return read_dataset(path)
        except DatasetFaultError as fault:
            if fault.code != NO_DATASET:
                raise
    raise Refused(
        "no_release",
        f"{folder} contains no dataset: put the released ZIP, or its folder STONE_nus_dataset, there",
    )


def bags_in(folder: Path) -> list[Path]:
    """Return the recordings in a folder, or in folders in it. Raises `no_release` if there is none."""
    inside = sorted(folder.iterdir())
    folders = (path for path in inside if path.is_dir() and not is_recording(path))
    bags = [
        path for path in (*inside, *(deep for path in folders for deep in sorted(path.iterdir()))) if is_recording(path)
    ]
    if not bags:
        raise Refused(
            "no_release",
            f"{folder} contains no bag: put a bag of the release there (a folder with metadata.yaml and a .db3)",
        )
    return bags


def paired(bag: Path, index: DatasetIndex, out: Path) -> ReleasedPair:
    """Return a bag with its released labels; its calibration, from the released tables, is written to `out`.

    Raises `no_release` if no frame has any or their LiDAR's mounts differ, and what opening a recording raises.
    """
    name = re.sub(r"[^A-Za-z0-9._-]", "-", bag.stem)
    with open_bag(bag) as opened:
        opened.believe()
        mount = _mount(opened, index)
        write_calibration(Calibration(name, mount), calibration_in(out, name))
        options = SynchroniseOptions(ground="auto", is_hashed=False, is_checked=False)
        sequence, sweeps = sequence_in(opened, calibration_in(out, name), name, options)
    labelled = list(_labelled(index))
    stamps_ns = np.array([item.stamps_ns[frame] for item, frame, _ in labelled], np.int64)
    rows, theirs = matched(sequence.frames.stamps_ns, stamps_ns)
    if not len(rows):
        raise _none_matched(bag, sequence, stamps_ns)
    chosen = [labelled[at] for at in theirs.tolist()]
    ours_m = (sequence.frames.map_from_ego[rows] @ sequence.calibration.ego_from_lidar).translation_m
    theirs_m = np.array([(item.map_from_ego[frame] @ mount).translation_m for item, frame, _ in chosen])
    off_ns, apart_m = stamps_ns[theirs] - sequence.frames.stamps_ns[rows], np.linalg.norm(ours_m - theirs_m, axis=1)
    labels = tuple(span for *_, span in chosen)
    return ReleasedPair(name, sequence, sweeps, index.layout, mount, rows, labels, off_ns, apart_m)


def calibration_in(out: Path, name: str) -> Path:
    """Return the path of a bag's calibration."""
    return out / f"{name}.calibration.yaml"


def _labelled(index: DatasetIndex) -> Iterator[tuple[DatasetSequence, int, ExportFileSpan]]:
    """Yield every frame with labels, and their file. Raises `no_release` if there is none."""
    is_any = False
    for sequence in (sequence for sequence in index.sequences if sequence.is_labelled):
        for frame in range(len(sequence)):
            if (span := index.labels(sequence, frame)) is not None:
                is_any = True
                yield sequence, frame, span
    if not is_any:
        raise Refused(
            "no_release", f"{index.files.path.name} has no labels: gts/<scene>/<token>/labels.npz are expected"
        )


def matched(ours_ns: NDArray[np.int64], theirs_ns: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices (M,) of matching stamps in `ours_ns` (N,) and in `theirs_ns` (K,), which is not empty."""
    order = np.argsort(theirs_ns, kind="stable")
    right = np.searchsorted(theirs_ns[order], ours_ns)
    beside = order[np.clip([right - 1, right], 0, len(order) - 1)]
    off_ns = np.abs(theirs_ns[beside] - ours_ns)
    nearest = np.take_along_axis(beside, off_ns.argmin(axis=0)[None], axis=0)[0]
    rows = np.flatnonzero(off_ns.min(axis=0) <= MOST_OFF_NS).astype(np.int64)
    return rows, nearest[rows]


def _mount(bag: Bag, index: DatasetIndex) -> SE3:
    """Return the LiDAR's mount in the released tables: the mount of all scenes, or else of the scenes of the bag's
    time.
    """
    mounts = _mounts(index.sequences)
    if len(mounts) > 1:
        begin_ns, end_ns = bag.start_ns - MARGIN_NS, bag.end_ns + MARGIN_NS
        mounts = _mounts(
            [
                sequence
                for sequence in index.sequences
                if sequence.stamps_ns[0] < end_ns and sequence.stamps_ns[-1] > begin_ns
            ]
        )
    if len(mounts) != 1:
        raise Refused(
            "no_release",
            f"{bag.path.name}: the scenes at its time have {len(mounts)} mounts of {LIDAR_CHANNEL} in "
            "calibrated_sensor, but the comparison requires one (is it a bag of this dataset?)",
        )
    return mounts[0]


def _mounts(sequences: Iterable[DatasetSequence]) -> list[SE3]:
    """Return the different mounts of the LiDAR, to 0.1 mm and 1e-4 of a rotation."""
    mounts = [item.channels[LIDAR_CHANNEL].sensor.ego_from_sensor for item in sequences]
    rounded = {tuple(np.round(item.as_matrix(), 4).ravel().tolist()): item for item in mounts}
    return list(rounded.values())


def _none_matched(bag: Path, sequence: Sequence, theirs_ns: NDArray[np.int64]) -> Refused:
    ours_ns = sequence.frames.stamps_ns
    nearest_s = float(np.abs(theirs_ns[:, None] - ours_ns[[0, -1]]).min()) * 1e-9
    return Refused(
        "no_release",
        f"{bag.name}: none of its {len(ours_ns)} frames has released labels. The nearest released frame is "
        f"{nearest_s:.3f} s from its ends, at most {MOST_OFF_NS * 1e-9:g} s are allowed: check that the bag is of this "
        "dataset",
    )
