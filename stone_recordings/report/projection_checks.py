"""The check that LiDAR points project onto camera images; it finds inverted transforms.

**Conventions.** A camera must see more than 5 % of a sweep's points (less for a lens narrower than 36°) and look in the
direction of its name (design §2). If only the inverted transform does so, the finding reports the inversion. Errors are
findings here: labels need no camera, so a recording with a wrong camera is still useful.
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
    """Return the faults of the cameras: their pictures (`picture_findings`), then the physical test.

    CAL-404 for each camera that fails it, or one for `ego_from_lidar` if that explains all; () without cameras. Raises
    the errors of reading the bag (BAG-*) and of `sweeps.sweep_in`.
    """
    return picture_findings(bag, sequence, sweeps) + view_findings(bag, sequence, sweeps)


def view_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """Return the findings of the physical test alone."""
    sampled: dict[str, list[CameraSweepPair]] = {}
    for pair in pairs(bag, sequence, sweeps, SAMPLED_FRAMES):
        sampled.setdefault(pair.mount.name, []).append(_thinned(pair))
    ego_from_lidar = sequence.calibration.ego_from_lidar
    views = {name: _view(sampled_pairs, ego_from_lidar) for name, sampled_pairs in sampled.items()}
    wrong = [name for name, sampled_pairs in sampled.items() if views[name].is_wrong(_least(sampled_pairs))]
    if len(wrong) > 1 and all(_fits(sampled_pairs, ego_from_lidar.inverse()) for sampled_pairs in sampled.values()):
        return (_ego_finding(len(wrong)),)
    findings = (_finding(sampled_pairs, views[name], ego_from_lidar) for name, sampled_pairs in sampled.items())
    return tuple(finding for finding in findings if finding is not None)


def _thinned(pair: CameraSweepPair) -> CameraSweepPair:
    """Return the pair with enough points to measure a share to a fraction of a percent; an odd step meets every
    ring.
    """
    every = max(1, len(pair.points_lidar) // MOST_POINTS) | 1
    return replace(pair, points_lidar=np.ascontiguousarray(pair.points_lidar[::every]))


def _view(pairs: list[CameraSweepPair], ego_from_lidar: SE3) -> CameraView:
    """Return the camera's view with the median share of points over the sampled frames."""
    views = [view_of(pair.mount, ego_from_lidar, pair.points_camera) for pair in pairs]
    return replace(views[0], seen_ratio=float(np.median([view.seen_ratio for view in views])))


def _fits(pairs: list[CameraSweepPair], ego_from_lidar: SE3) -> bool:
    view = _view(pairs, ego_from_lidar)
    return view.is_plausible and not view.is_wrong(_least(pairs))


def _least(pairs: list[CameraSweepPair]) -> float:
    intrinsics = pairs[0].mount.intrinsics
    return least_seen_ratio(intrinsics) if intrinsics is not None else 0.0


def _turned(pair: CameraSweepPair) -> CameraSweepPair:
    """Return the pair as if the file's `lidar_from_camera` were `camera_from_lidar`, without the motion of a few cm."""
    mount = replace(pair.mount, lidar_from_sensor=pair.mount.lidar_from_sensor.inverse())
    return replace(pair, mount=mount, camera_from_lidar=pair.mount.lidar_from_sensor)


def _finding(pairs: list[CameraSweepPair], view: CameraView, ego_from_lidar: SE3) -> Finding | None:
    """Return CAL-404 if the test fails or the image is so tilted that the inverse is the likelier mount; else None."""
    mount = pairs[0].mount
    is_wrong = view.is_wrong(_least(pairs))
    if not is_wrong and view.is_plausible:
        return None
    is_inverted = _fits([_turned(pair) for pair in pairs], ego_from_lidar)
    if not is_wrong and not is_inverted:
        return None
    likely = "the transform is inverted: read as camera_from_lidar it fits" if is_inverted else "is it this camera's?"
    return Finding("CAL-404", "error", mount.name, f"{mount.name}: {_seen(view, _least(pairs))}; {likely}")


def _seen(view: CameraView, least_ratio: float) -> str:
    seen = (
        f"{view.seen_ratio * 100:.1f} % of the LiDAR's points project into it (expected: > {least_ratio * 100:.1f} %)"
    )
    if view.off_name_deg is not None:
        seen += f", it looks {view.off_name_deg:.0f}° off the direction in its name"
    return seen if view.is_plausible else seen + " and its image is not upright"


def _ego_finding(count: int) -> Finding:
    sentence = (
        f"{EGO_FROM_LIDAR}: {count} cameras look away from where their names say, and all fit with its inverse: "
        "the transform is lidar_from_ego"
    )
    return Finding("CAL-404", "error", EGO_FROM_LIDAR, sentence)


# The check that recorded images have the sizes for which the cameras were calibrated. Only the header of one picture of
# each topic is read: the picture in the overlay. A misfit is a finding, not a refusal: labels need no camera. CAL-403:
# another size; CAL-412: a camera that the calibration lacks.


def picture_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """Return the faults of the cameras' pictures, topic by topic; () without cameras."""
    types = {topic.name: topic.type for topic in bag.topics}
    associations = sequence.frames.associations
    topics = {
        name: association.topic
        for name, association in associations.items()
        if types.get(association.topic) in CAMERA_TYPES
    }
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
