"""A rig from a recording itself: /tf_static places the sensors, CameraInfo contains the cameras' intrinsics.

**Conventions.** For CameraInfo the first message of each topic counts, for tf_static the last transform of a pair. A
camera that is marked as uncalibrated (k = 0) has no lens.
"""

from pathlib import Path

from stone.sensors.calibration import CameraIntrinsics
from stone.sensors.calibration_checks import Findings, check_translation
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.magic import is_container
from stone_recordings.calibrations.errors import half_rig
from stone_recordings.calibrations.part import CalibrationPart, Edge, LensText, intrinsics
from stone_recordings.messages import camera_info, tf
from stone_recordings.poses.extrinsics import plain

TF_STATIC = "tf_static"
MOST_MESSAGES = 1000
BAG_SUFFIXES = (".mcap", ".db3", ".bag", ".active", ".zstd")


def is_recording(path: Path) -> bool:
    """Return whether the path is a bag file, or a folder that holds one."""
    if path.is_dir():
        return any(file.suffix in BAG_SUFFIXES for file in path.iterdir())
    return path.is_file() and is_container(path)


def recorded_part(bag: Bag) -> CalibrationPart:
    """Return the rig as a part. Raises `CAL-424` without /tf_static, and the errors of `recorded_facts`."""
    part = recorded_facts(bag)
    if not part.edges:
        raise half_rig(bag.path.name, "it recorded no /tf_static", "give the calibration as a file of its own")
    return part


def recorded_facts(bag: Bag) -> CalibrationPart:
    """Return the rig's facts in a recording. Raises the errors of decoding (BAG-*, MSG-*) and of the lenses."""
    topics = [topic for topic in bag.topics if topic.count and topic.encoding == "cdr"]
    static = [topic.name for topic in topics if topic.type == tf.TYPE and topic.name.endswith(TF_STATIC)]
    cameras = [topic.name for topic in topics if topic.type == camera_info.TYPE]
    edges, findings = _edges(bag, static)
    lenses = _lenses(bag, cameras)
    return CalibrationPart(bag.path.name, "tf_static", edges, lenses, optical=frozenset(lenses), findings=findings)


def _edges(bag: Bag, topics: list[str]) -> tuple[tuple[Edge, ...], Findings]:
    edges, findings = dict[tuple[str, str], Edge](), Findings()
    for topic in topics:
        for pair in tf.decode_transforms(list(bag.messages(topic, 0, MOST_MESSAGES))):
            edge = Edge(plain(pair.parent), plain(pair.child), pair.parent_from_child[-1])
            edges[(edge.parent, edge.child)] = edge
            findings += check_translation(edge.child, edge.parent_from_child.translation_m)
    return tuple(edges.values()), findings


def _lenses(bag: Bag, topics: list[str]) -> dict[str, CameraIntrinsics]:
    lenses = {}
    for topic in topics:
        info = camera_info.decode_camera_info([bag.message(topic, 0)]).infos[0]
        if info.is_calibrated:
            text = LensText(topic, plain(info.frame_id), info.model, tuple(info.distortion.tolist()))
            lenses[text.sensor] = intrinsics(text, info.k, (info.width_px, info.height_px))
    return lenses
