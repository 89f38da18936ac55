"""Seed inputs for fuzzing: a tiny simulated drive, written by third-party libraries.

**Conventions.** Inputs have no checksums, since mutations would fail there; libFuzzer mutates the rest.
"""

import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from fuzz.calibrations import calibrations
from fuzz.datasets import published_seeds
from fuzz.exported_frames import exported_labels_seeds, frames_seeds, picture_seeds, scan_seeds
from fuzz.exports import table_seeds, tar_seeds
from fuzz.joined import joined_seeds
from fuzz.labels import label_seeds
from fuzz.messages import DECODERS
from fuzz.packets import packet_seeds, pose_seeds
from fuzz.points import point_seeds, raw_picture_seeds
from fuzz.submissions import archive_seeds, frame_seeds, header_seeds, manifest_seeds
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.types.registry import message_definition, typestore
from testing.worlds.ros1_bags import ROS1_COMPRESSIONS, as_ros1, unclosed

LONGEST_SEED_BYTES = 50_000
MESSAGES_EACH = 3
OPTIONS = SimulateOptions(seconds=0.2, channels=4, columns=12, camera_width_px=32, world_width_m=30.0)
CONTAINERS: Mapping[str, Mapping[str, Any]] = {
    "plain": {"compression": CompressionType.NONE},
    "lz4": {"compression": CompressionType.LZ4},
    "zstd": {"compression": CompressionType.ZSTD},
    "unchunked": {"use_chunking": False, "compression": CompressionType.NONE},
    "unindexed": {"compression": CompressionType.NONE, "index_types": IndexType.NONE},
}


@dataclass(frozen=True)
class Sample:
    """A message of the tiny drive."""

    topic: str
    type: str
    log_time_ns: int
    payload: bytes


def write_seeds(target: str, corpus: Path) -> None:
    """Write the first inputs for the fuzzing of `target`, one file each."""
    for name, content in SEEDS[target]():
        (corpus / f"seed-{name}").write_bytes(content)


@cache
def samples() -> tuple[Sample, ...]:
    """Return the first messages of every topic, if they are small."""
    drawn: list[Sample] = []
    with TemporaryDirectory() as folder:
        path = Path(folder) / "tiny.mcap"
        simulate(path, OPTIONS)
        with open_bag(path) as bag:
            for topic in bag.topics:
                messages = list(bag.messages(topic.name, 0, MESSAGES_EACH))
                drawn += [Sample(topic.name, topic.type, m.log_time_ns, bytes(m.payload)) for m in messages]
    return tuple(sample for sample in drawn if len(sample.payload) <= LONGEST_SEED_BYTES)


def mcap_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield each file layout, whole and cut."""
    for name, layout in CONTAINERS.items():
        content = _mcap(layout)
        yield name, content
        yield f"{name}-cut", content[: len(content) * 3 // 4]


def ros1_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield each compression, closed, unclosed and cut."""
    with TemporaryDirectory() as folder:
        source = Path(folder) / "tiny.mcap"
        source.write_bytes(_mcap(CONTAINERS["plain"]))
        for compression in ROS1_COMPRESSIONS:
            closed = as_ros1(source, Path(folder) / f"{compression}.bag", compression, chunk_bytes=4000)
            yield compression, closed.read_bytes()
            content = unclosed(closed, Path(folder) / f"{compression}.bag.active").read_bytes()
            yield f"{compression}-unclosed", content
            yield f"{compression}-cut", content[: len(content) * 3 // 4]


def db3_seeds() -> Iterator[tuple[str, bytes]]:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "run"
        with RosbagsWriter(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
            channels = {
                topic: writer.add_connection(topic, kind, typestore=typestore())
                for topic, kind in {sample.topic: sample.type for sample in _small()}.items()
            }
            for sample in _small():
                writer.write(channels[sample.topic], sample.log_time_ns, sample.payload)
        for file in sorted(path.glob("*.db3")):
            with closing(sqlite3.connect(file, isolation_level=None)) as database:
                database.execute("PRAGMA page_size = 512")  # small inputs concentrate the mutations
                database.execute("VACUUM")
            yield file.stem, file.read_bytes()


def message_seeds() -> Iterator[tuple[str, bytes]]:
    """Yield every message for every decoder: most decoders refuse it, which is also worth testing."""
    for choice, _decoder in enumerate(DECODERS):
        for sample in {sample.type: sample for sample in samples()}.values():
            yield f"{choice}-{sample.type.replace('/', '-')}", bytes([choice]) + sample.payload


def definition_seeds() -> Iterator[tuple[str, bytes]]:
    for sample in {sample.type: sample for sample in samples()}.values():
        yield sample.type.replace("/", "-"), message_definition(sample.type).encode() + b"\0\0" + sample.payload


def calibration_seeds() -> Iterator[tuple[str, bytes]]:
    for name, (choice, content) in calibrations().items():
        yield name, bytes([choice]) + content


SEEDS: Mapping[str, Callable[[], Iterator[tuple[str, bytes]]]] = {
    "mcap": mcap_seeds,
    "ros1": ros1_seeds,
    "db3": db3_seeds,
    "messages": message_seeds,
    "definition": definition_seeds,
    "calibration": calibration_seeds,
    "archive": archive_seeds,
    "frame": frame_seeds,
    "header": header_seeds,
    "manifest": manifest_seeds,
    "tar": tar_seeds,
    "tables": table_seeds,
    "exported-frames": frames_seeds,
    "exported-labels": exported_labels_seeds,
    "exported-scan": scan_seeds,
    "exported-picture": picture_seeds,
    "datasets": published_seeds,
    "labels": label_seeds,
    "packets": packet_seeds,
    "poses": pose_seeds,
    "joined": joined_seeds,
    "points": point_seeds,
    "pictures": raw_picture_seeds,
}


def _small() -> list[Sample]:
    return [sample for sample in samples() if len(sample.payload) < 4096]


def _mcap(layout: Mapping[str, Any]) -> bytes:
    file = BytesIO()
    writer = Writer(file, chunk_size=4000, enable_crcs=False, **layout)
    writer.start(profile="ros2", library="")
    channels: dict[str, int] = {}
    for sample in sorted(_small(), key=lambda sample: sample.log_time_ns):
        if sample.topic not in channels:
            schema = writer.register_schema(sample.type, "ros2msg", message_definition(sample.type).encode()[:400])
            channels[sample.topic] = writer.register_channel(sample.topic, "cdr", schema)
        writer.add_message(channels[sample.topic], sample.log_time_ns, sample.payload, sample.log_time_ns)
    writer.finish()  # type: ignore[no-untyped-call]
    return file.getvalue()
