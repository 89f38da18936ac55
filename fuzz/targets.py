"""The fuzzed targets: the readers of untrusted bytes, and labelling, each as one function of bytes.

**Conventions.** A target ends normally or with a `StoneError`. For `messages`, `packets` and `points` the first byte
selects the type, for `calibration` the suffix of its name; the rest is the content.
"""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from fuzz.datasets import read_published
from fuzz.exported_frames import read_frames, read_labels, read_picture, read_scan
from fuzz.exports import read_tables, read_tar
from fuzz.joined import read_description
from fuzz.labels import read_and_label
from fuzz.limits import OF_LABELLING, OF_PARSERS, FuzzLimits, Target
from fuzz.messages import DECODERS
from fuzz.packets import read_packets, read_poses
from fuzz.points import read_points, read_raw_picture
from fuzz.submissions import read_archive, read_frame, read_header, read_manifest_file
from stone.errors import StoneError
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.messages.batch import StampedMessage
from stone_recordings.messages.types.registry import resolved
from stone_recordings.messages.types.table import decode_table
from stone_recordings.report.inspection import inspect
from stone_recordings.sync.recorded_messages import OwnMessage

DESCRIBED = "field_msgs/msg/Reading"
ENDINGS = (".yaml", ".json", ".zip", ".txt", ".urdf")


def read_recording(path: Path) -> None:
    """Run everything that reads bytes: the catalogue, every payload, the inspection."""
    with open_bag(path) as bag:
        for topic in bag.topics:
            if topic.encoding == "cdr":
                for message in bag.messages(topic.name):
                    bytes(message.payload[:4096])
    inspect(path)


def read_mcap(content: bytes) -> None:
    """Read it as it is; if it is cut off, also recover its readable part."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.mcap"
        path.write_bytes(content)
        try:
            read_recording(path)
        except StoneError:
            recover(path, Path(folder) / "recovered.mcap")
            read_recording(Path(folder) / "recovered.mcap")


def read_ros1(content: bytes) -> None:
    """Read it as it is, and recover its readable part."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.bag"
        path.write_bytes(content)
        with suppress(StoneError):
            read_recording(path)
        recover(path, Path(folder) / "recovered.mcap")
        read_recording(Path(folder) / "recovered.mcap")


def read_db3(content: bytes) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run.db3"
        path.write_bytes(content)
        read_recording(path)


def read_messages(content: bytes) -> None:
    """Read one message twice, for code that compares it with its predecessor."""
    if content:
        payload: StampedMessage = OwnMessage(memoryview(content[1:]))
        DECODERS[content[0] % len(DECODERS)]([payload, payload])


def read_calibration_file(content: bytes) -> None:
    if content:
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"rig{ENDINGS[content[0] % len(ENDINGS)]}"
            path.write_bytes(content[1:])
            read_calibration(path)


def read_definition(content: bytes) -> None:
    """Read a type's definition as a recording contains it, and one message of this type from the same bytes."""
    text, _, payload = content.partition(b"\0\0")
    known = resolved(DESCRIBED, text.decode("utf-8", "replace")).registry
    decode_table(DESCRIBED, [OwnMessage(memoryview(payload))], known)


TARGETS: Mapping[str, Target] = {
    "mcap": read_mcap,
    "ros1": read_ros1,
    "db3": read_db3,
    "messages": read_messages,
    "definition": read_definition,
    "calibration": read_calibration_file,
    "archive": read_archive,
    "frame": read_frame,
    "header": read_header,
    "manifest": read_manifest_file,
    "tar": read_tar,
    "tables": read_tables,
    "exported-frames": read_frames,
    "exported-labels": read_labels,
    "exported-scan": read_scan,
    "exported-picture": read_picture,
    "datasets": read_published,
    "labels": read_and_label,
    "packets": read_packets,
    "poses": read_poses,
    "joined": read_description,
    "points": read_points,
    "pictures": read_raw_picture,
}


def limits_of(name: str) -> FuzzLimits:
    """Return the limits for an input of this target."""
    return OF_LABELLING if name == "labels" else OF_PARSERS
