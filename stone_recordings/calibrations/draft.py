"""The merged parts of a calibration bundle: one frame tree, the lenses by name, and the sensors.

**Conventions.** Frames are in the order in which files name them. Two files may contain the same entry; if the entries
differ by more than rounding they are refused, because the shortest path would silently choose one.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from stone.sensors.calibration import CameraIntrinsics, SensorKind
from stone_recordings.calibrations.errors import conflicting_files
from stone_recordings.calibrations.part import CalibrationPart, Edge
from stone_recordings.poses.static_tree import StaticTree

SAME_M_OR_RATIO = 1e-4


@dataclass(frozen=True, eq=False)
class RigDraft:
    """`name` is that of the file, folder or zip; the rest is the content of all parts."""

    name: str
    tree: StaticTree
    frames: tuple[str, ...]
    lenses: Mapping[str, CameraIntrinsics]
    offsets_ns: Mapping[str, int]
    kinds: Mapping[str, SensorKind]
    optical: frozenset[str]

    def kind(self, frame: str) -> SensorKind | None:
        if frame in self.kinds:
            return self.kinds[frame]
        return "camera" if frame in self.lenses else kind_of(frame)

    def frame_of_lens(self, lens: str) -> str:
        """Return the frame of a camera's lens: the frame of the same name, else the only camera's frame of the same
        sensor.
        """
        if lens in self.frames:
            return lens
        same = [frame for frame in self.frames_of("camera") if sensor_key(frame) == sensor_key(lens)]
        return self.foremost(same) if same else lens

    def frames_of(self, kind: SensorKind) -> list[str]:
        return [frame for frame in self.frames if self.kind(frame) == kind]

    def sensors_of(self, kind: SensorKind) -> list[str]:
        """Return one frame for each sensor of a kind: frames of the same sensor count once."""
        groups: dict[str, list[str]] = {}
        for frame in self.frames_of(kind):
            key = frame if frame in self.kinds or frame in self.lenses else sensor_key(frame)
            groups.setdefault(key, []).append(frame)
        return [self.foremost(group) for group in groups.values()]

    def foremost(self, frames: list[str]) -> str:
        """Return the optical frame, else the one at the end of the chain."""
        optical = [frame for frame in frames if frame in self.optical or is_optical(frame)]
        parents = {parent for parent, child in self.tree.edges if child in frames and self.tree.is_down(parent, child)}
        ends = [frame for frame in frames if frame not in parents]
        return (optical or ends or frames)[0]


def draft_of(name: str, parts: Iterable[CalibrationPart]) -> RigDraft:
    """Merge parts. Raises `CAL-429`."""
    edges: dict[frozenset[str], tuple[Edge, str]] = {}
    lenses: dict[str, tuple[CameraIntrinsics, str]] = {}
    offsets_ns, kinds, optical = dict[str, int](), dict[str, SensorKind](), frozenset[str]()
    for part in parts:
        for edge in part.edges:
            _add_edge(name, edges, edge, part.file)
        for lens, intrinsics in part.lenses.items():
            known, file = lenses.setdefault(lens, (intrinsics, part.file))
            if known != intrinsics:
                raise conflicting_files(name, f"the intrinsics of {lens}", (file, part.file))
        offsets_ns |= part.offsets_ns
        kinds |= part.kinds
        optical |= part.optical
    all_edges = [edge for edge, _ in edges.values()]
    frames = tuple(dict.fromkeys(frame for edge in all_edges for frame in (edge.parent, edge.child)))
    tree = StaticTree.of((edge.parent, edge.child, edge.parent_from_child) for edge in all_edges)
    return RigDraft(
        name, tree, frames, {lens: camera for lens, (camera, _) in lenses.items()}, offsets_ns, kinds, optical
    )


def _add_edge(name: str, edges: dict[frozenset[str], tuple[Edge, str]], edge: Edge, file: str) -> None:
    pair = frozenset((edge.parent, edge.child))
    known, before = edges.setdefault(pair, (edge, file))
    same = known.parent_from_child if known.parent == edge.parent else known.parent_from_child.inverse()
    apart = np.abs(same.as_matrix() - edge.parent_from_child.as_matrix()).max()
    if apart > SAME_M_OR_RATIO or len(pair) == 1:
        files = tuple(dict.fromkeys((before, file)))
        raise conflicting_files(name, f"the transform from {edge.child} to {edge.parent}", files)


# Names of frames on robots: the kind of a sensor, frames of the same sensor, and channels. A name is split at every
# non-letter, and its words lose their digits for the kind (`cam0` is a camera). A file's own statement takes precedence
# over names, and names never choose between two that fit.

# In the order of evaluation: `os_imu` is an IMU, `lidar_camera` a camera.
KINDS: tuple[tuple[SensorKind, frozenset[str]], ...] = (
    ("imu", frozenset({"imu", "xsens", "microstrain"})),
    ("camera", frozenset({"camera", "cam"})),
    ("radar", frozenset({"radar", "ars", "srr"})),
    ("ins", frozenset({"ins", "gnss", "gps", "novatel", "inspvax"})),
    ("lidar", frozenset({"lidar", "laser", "velodyne", "hesai", "pandar", "ouster", "os", "vlp", "livox", "rslidar"})),
)
MEANINGLESS = frozenset({"link", "frame", "optical", "base", "sensor", "mount"})
# Frames on the ground come first: the ego frame's origin is there (REP 105 and 120).
EGO_FRAMES = ("base_footprint", "ground_projection", "ego", "ego_vehicle", "base_link", "base", "car_center")
DIRECTIONS = {
    "front": "FRONT", "forward": "FRONT", "back": "BACK", "rear": "BACK", "left": "LEFT", "right": "RIGHT",
}  # fmt: skip
# Words that may stand beside a direction: front_center_camera is the front one, traffic_light_right_camera no right
# one.
SAYING_NOTHING = frozenset({"camera", "cam", "radar", "center", "centre", "middle", "rgb", "color"})
PREFIXES = {"camera": "CAM", "radar": "RADAR"}


def words_of(name: str) -> list[str]:
    return [word for word in re.split(r"[^a-z0-9]+", name.lower()) if word]


def kind_of(name: str) -> SensorKind | None:
    """Return the kind of a frame or sensor by its name; None for other frames (base_link, sensor_kit_base_link)."""
    bare = {re.sub(r"\d+", "", word) for word in words_of(name)}
    if "kit" in bare:
        return None
    return next((kind for kind, meaning in KINDS if bare & meaning), None)


def sensor_key(name: str) -> str:
    """Return a key that the frames of one sensor share: camera_front_link, camera_front_optical_frame; os_sensor,
    os_lidar.
    """
    kinds = frozenset[str]().union(*(meaning for _, meaning in KINDS)) - {"os"}
    words = [word for word in words_of(name) if word not in MEANINGLESS]
    return "_".join(word for word in words if word not in kinds) or "_".join(words)


def is_optical(name: str) -> bool:
    return "optical" in words_of(name)


def channel_of(name: str, kind: SensorKind) -> str:
    """Return CAM_FRONT_LEFT for camera_front_left, INS and IMU for theirs; else the name itself."""
    if kind in ("ins", "imu"):
        return kind.upper()
    words = words_of(name)
    others = set(words) - MEANINGLESS - SAYING_NOTHING - set(DIRECTIONS)
    directions = {DIRECTIONS[word] for word in words if word in DIRECTIONS}
    places = [direction for direction in ("FRONT", "BACK", "LEFT", "RIGHT") if direction in directions]
    return "_".join([PREFIXES[kind], *places]) if kind in PREFIXES and places and not others else name
