"""The check that LiDAR points project onto camera images; it finds inverted transforms.

**Conventions.** A camera must see more than 5 % of a sweep's points (less for a lens narrower than 36°) and look where
its name says (design §2). Where it does not and the transform read the other way round does, the finding says so.
Errors are findings here: labels need no camera, so a recording with a wrong one is still of use.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.calibration_checks import check_image_size, require_mounts
from stone.sensors.calibration_errors import ImageSizeError, MissingSensorError
from stone.sensors.camera_views import CameraView, least_seen_ratio, view_of
from stone.sensors.sequence import Sequence
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.camera import CAMERA_TYPES, decode_image
from stone_recordings.sync.camera_sweeps import CameraSweepPair, pairs, shown_message
from stone_recordings.sync.sweeps import BagSweeps

SAMPLED_FRAMES = 3
MOST_POINTS = 20_000
EGO_FROM_LIDAR = "ego_from_lidar"


def projection_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """What is wrong with the cameras: their pictures (`picture_findings`), then the physical test.

    CAL-404 for each camera that fails it, or one for `ego_from_lidar` where that explains them all; () without cameras.
    Raises what reading the bag raises (BAG-*) and what `sweeps.sweep_in` raises.
    """
    return picture_findings(bag, sequence, sweeps) + view_findings(bag, sequence, sweeps)


def view_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """The physical test alone."""
    sampled: dict[str, list[CameraSweepPair]] = {}
    for pair in pairs(bag, sequence, sweeps, SAMPLED_FRAMES):
        sampled.setdefault(pair.mount.name, []).append(_thinned(pair))
    ego_from_lidar = sequence.calibration.ego_from_lidar
    views = {name: _view(found, ego_from_lidar) for name, found in sampled.items()}
    wrong = [name for name, found in sampled.items() if views[name].is_wrong(_least(found))]
    if len(wrong) > 1 and all(_fits(found, ego_from_lidar.inverse()) for found in sampled.values()):
        return (_ego_finding(len(wrong)),)
    findings = (_finding(found, views[name], ego_from_lidar) for name, found in sampled.items())
    return tuple(finding for finding in findings if finding is not None)


def _thinned(pair: CameraSweepPair) -> CameraSweepPair:
    """With no more points than tell a share of them to a fraction of a percent; an odd step meets every ring."""
    every = max(1, len(pair.points_lidar) // MOST_POINTS) | 1
    return replace(pair, points_lidar=np.ascontiguousarray(pair.points_lidar[::every]))


def _view(found: list[CameraSweepPair], ego_from_lidar: SE3) -> CameraView:
    """The camera's view with the median share of points over the sampled frames."""
    views = [view_of(pair.mount, ego_from_lidar, pair.points_camera) for pair in found]
    return replace(views[0], seen_ratio=float(np.median([view.seen_ratio for view in views])))


def _fits(found: list[CameraSweepPair], ego_from_lidar: SE3) -> bool:
    view = _view(found, ego_from_lidar)
    return view.is_plausible and not view.is_wrong(_least(found))


def _least(found: list[CameraSweepPair]) -> float:
    intrinsics = found[0].mount.intrinsics
    return least_seen_ratio(intrinsics) if intrinsics is not None else 0.0


def _turned(pair: CameraSweepPair) -> CameraSweepPair:
    """The pair as if the file's `lidar_from_camera` were `camera_from_lidar`; the motion, a few cm, is left out."""
    mount = replace(pair.mount, lidar_from_sensor=pair.mount.lidar_from_sensor.inverse())
    return replace(pair, mount=mount, camera_from_lidar=pair.mount.lidar_from_sensor)


def _finding(found: list[CameraSweepPair], view: CameraView, ego_from_lidar: SE3) -> Finding | None:
    """Wrong by the test, or so tilted that the inverse is the likelier mount; None for a camera that is neither."""
    mount = found[0].mount
    is_wrong = view.is_wrong(_least(found))
    if not is_wrong and view.is_plausible:
        return None
    is_inverted = _fits([_turned(pair) for pair in found], ego_from_lidar)
    if not is_wrong and not is_inverted:
        return None
    likely = "the transform is inverted: read as camera_from_lidar it fits" if is_inverted else "is it this camera's?"
    return Finding("CAL-404", "error", mount.name, f"{mount.name}: {_seen(view, _least(found))}; {likely}")


def _seen(view: CameraView, least_ratio: float) -> str:
    seen = (
        f"{view.seen_ratio * 100:.1f} % of the LiDAR's points project into it (expected: > {least_ratio * 100:.1f} %)"
    )
    if view.off_name_deg is not None:
        seen += f", it looks {view.off_name_deg:.0f}° from where its name says"
    return seen if view.is_plausible else seen + " and its image is not upright"


def _ego_finding(count: int) -> Finding:
    sentence = (
        f"{EGO_FROM_LIDAR}: {count} cameras look away from where their names say, and all fit with its inverse: "
        "the transform is lidar_from_ego"
    )
    return Finding("CAL-404", "error", EGO_FROM_LIDAR, sentence)


# The check that recorded images match the sizes the cameras were calibrated for.
#
# **Conventions.** One picture of each topic is looked at, its header only: the one that the overlay shows. What does
# not fit is a finding, not a refusal: labels need no camera. CAL-403: another size; CAL-412: a camera the calibration
# does not know.


def picture_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """What is wrong with the cameras' pictures, topic by topic; () without cameras."""
    types = {topic.name: topic.type for topic in bag.topics}
    associations = sequence.frames.associations
    topics = {name: found.topic for name, found in associations.items() if types.get(found.topic) in CAMERA_TYPES}
    findings = _unknown(sequence.calibration, tuple(topics))
    for name, topic in topics.items():
        index = shown_message(sequence, sweeps, name)
        if index is not None:
            findings += tuple(_misfits(bag, sequence.calibration.mount(name), (topic, types[topic], index)))
    return findings


def _unknown(calibration: Calibration, names: tuple[str, ...]) -> tuple[Finding, ...]:
    try:
        require_mounts(calibration, names, "projecting the LiDAR's points into every image")
    except MissingSensorError as error:
        return (Finding(error.code, "warning", "", str(error)),)
    return ()


def _misfits(bag: Bag, mount: Mount | None, shown: tuple[str, str, int]) -> Iterator[Finding]:
    topic, type_name, index = shown
    if mount is None:
        return
    try:
        picture = decode_image(bag.message(topic, index).payload, type_name)
        check_image_size(mount, picture.width_px, picture.height_px)
    except ImageSizeError as error:
        yield Finding(error.code, "error", mount.name, str(error))
    except IngestError as error:  # its frames lack it, labels do not
        yield Finding(error.code, "warning", topic, f"{error}; frames whose picture cannot be read have none")
