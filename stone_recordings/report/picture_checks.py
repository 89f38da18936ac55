"""The check that recorded images match the sizes the cameras were calibrated for.

**Conventions.** One picture of each topic is looked at, its header only. What does not fit is a finding, not a refusal:
labels need no camera. CAL-403: another size; CAL-412: a camera the calibration does not know.
"""

from collections.abc import Iterator

from stone.findings import Finding
from stone.sensors.calibration import Calibration
from stone.sensors.calibration_checks import check_image_size, require_mounts
from stone.sensors.calibration_errors import ImageSizeError, MissingSensorError
from stone.sensors.sequence import Sequence
from stone_recordings.bags.bag import Bag
from stone_recordings.bags.errors import IngestError
from stone_recordings.messages.camera import CAMERA_TYPES, decode_image


def picture_findings(bag: Bag, sequence: Sequence) -> tuple[Finding, ...]:
    """What is wrong with the cameras' pictures, topic by topic; () without cameras."""
    types = {topic.name: topic.type for topic in bag.topics}
    associations = sequence.frames.associations
    topics = {name: found.topic for name, found in associations.items() if types.get(found.topic) in CAMERA_TYPES}
    findings = _unknown(sequence.calibration, tuple(topics))
    for name, topic in topics.items():
        findings += tuple(_misfits(bag, sequence, (name, topic, types[topic])))
    return findings


def _unknown(calibration: Calibration, names: tuple[str, ...]) -> tuple[Finding, ...]:
    try:
        require_mounts(calibration, names, "projecting the LiDAR's points into every image")
    except MissingSensorError as error:
        return (Finding(error.code, "warning", "", str(error)),)
    return ()


def _misfits(bag: Bag, sequence: Sequence, camera: tuple[str, str, str]) -> Iterator[Finding]:
    name, topic, type_name = camera
    mount = sequence.calibration.mount(name)
    taken = sequence.frames.associations[name].message_index
    index = next((int(index) for index in taken if index >= 0), None)
    if mount is None or index is None:
        return
    try:
        picture = decode_image(bag.message(topic, index).payload, type_name)
        check_image_size(mount, picture.width_px, picture.height_px)
    except (IngestError, ImageSizeError) as error:
        yield Finding(error.code, "error", name if isinstance(error, ImageSizeError) else topic, str(error))
