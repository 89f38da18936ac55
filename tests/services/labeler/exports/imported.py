"""The drive as it comes back: its own nuScenes export as the source of an imported label set.

**Conventions.** As an import reads it: times are whole microseconds, poses those of `global`, tokens and calibration
those of the tables, and an association names the place of a datum among its channel's.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from services.labeler.exports.dataset_samples import DatasetSamples
from services.labeler.exports.dataset_source import DatasetSource
from services.labeler.exports.nuscenes.layout import write_nuscenes
from services.labeler.exports.nuscenes.map_mask import mask_of
from services.labeler.exports.ply_file import open_mesh
from services.labeler.exports.source import LabelledSequence
from services.runtime.store.packs import index_bytes, pack_count, pack_folder, pack_path
from stone.geometry.se3 import SE3
from stone.geometry.trajectory import Trajectory
from stone.sensors.samples import egos_at
from stone.sensors.sequence import Association, Frames, Sequence
from tests.services.labeler.exports.made import unheard

NS_PER_US = 1000


@dataclass(frozen=True)
class Published:
    """An export in the release's layout, and the same files, without labels, as an import keeps them."""

    folder: Path
    source: DatasetSource


def published(labelled: LabelledSequence, root: Path) -> Published:
    folder, kept = root / "published", root / "kept"
    folder.mkdir(parents=True)
    write_nuscenes(labelled, folder, unheard)
    for path in (path for path in sorted(folder.rglob("*")) if path.is_file()):
        relative = path.relative_to(folder)
        if relative.parts[0] != "gts":
            (kept / relative).parent.mkdir(parents=True, exist_ok=True)
            (kept / relative).write_bytes(path.read_bytes())
    return Published(folder, packed_source(kept, root / "packed"))


def packed_source(files: Path, root: Path) -> DatasetSource:
    """The files of a folder, moved into packs that begin anew every few files."""
    packed = pack_folder(files, root, unheard, pack_bytes=1 << 18)
    (root / "index.npz").write_bytes(index_bytes(packed))
    return DatasetSource(root / "index.npz", tuple(pack_path(root, number) for number in range(pack_count(packed))))


def imported(labelled: LabelledSequence, made: Published) -> LabelledSequence:
    """The labels with what the dataset says of them, in the place of what the recording did."""
    low_m = mask_of(open_mesh(labelled.mesh), labelled.sequence.frames.map_from_ego.translation_m[:, :2]).low_m
    sequence = sequence_of(labelled.sequence, low_m)
    samples = DatasetSamples(made.source, sequence)
    return replace(labelled, sequence=sequence, samples=samples, published=made.source.opened())


def sequence_of(recorded: Sequence, low_m: tuple[int, int]) -> Sequence:
    frames = recorded.frames
    stamps_ns = _whole(frames.stamps_ns)
    taken = {name: _taken(recorded, name) for name in frames.associations}
    associations = {name: one for name, one in taken.items() if not name.startswith("IMU")}
    kept = Frames(stamps_ns, frames.tokens, _shifted(frames.map_from_ego, low_m), associations)
    return replace(
        recorded,
        frames=replace(kept, sweeps=Association("LIDAR_TOP", np.arange(len(frames)), np.zeros(len(frames), np.int64))),
        track=_track(recorded, low_m),
        inputs={"published": "0" * 64},
        pose_source="dataset",
        excluded=(),
    )


def _taken(recorded: Sequence, name: str) -> Association:
    frames, one = recorded.frames, recorded.frames.associations[name]
    dt_ns = _whole(frames.stamps_ns + one.dt_ns) - _whole(frames.stamps_ns)
    place = np.where(one.message_index >= 0, np.cumsum(one.message_index >= 0) - 1, -1)
    return Association(name, place, np.where(one.message_index >= 0, dt_ns, 0))


def _track(recorded: Sequence, low_m: tuple[int, int]) -> Trajectory:
    """Through the ego poses of all data, in the order of their times."""
    frames = recorded.frames
    stamps, poses = [_whole(frames.stamps_ns)], [frames.map_from_ego.wxyz_xyz]
    for name in frames.associations:
        rows = np.flatnonzero(frames.associations[name].message_index >= 0)
        at_ns = frames.stamps_ns[rows] + frames.associations[name].dt_ns[rows]
        egos, is_ok = egos_at(recorded, rows, at_ns)
        stamps.append(_whole(at_ns[is_ok]))
        poses.append(egos.wxyz_xyz[is_ok])
    all_ns, places = np.unique(np.concatenate(stamps), return_index=True)
    return Trajectory(all_ns, _shifted(SE3(np.concatenate(poses)[places]), low_m))


def _shifted(poses: SE3, low_m: tuple[int, int]) -> SE3:
    moved = poses.wxyz_xyz.copy()
    moved[:, 4:6] -= low_m
    return SE3(moved)


def _whole(stamps_ns: np.ndarray) -> np.ndarray:
    return stamps_ns // NS_PER_US * NS_PER_US
