"""Speed of reading recordings compared with two common libraries: `python -m benchmarks.read [--rounds 5]`.

The readers take turns in one run, each in a process of its own. A figure is the best of its rounds, a ratio is ours to
the peer's in this run. Clouds: xyz of all points as contiguous (N, 3) float32, so all bytes are touched; ours is the
labeler's code with filtered returns, times and rings. Lists: all detections as arrays; the peers take minutes, so they
read the first part and are scaled by the count. Header scan: the stamp of every message of 400 MB of clouds. Growth is
the kernel's peak memory of the process above its initial value, mapped pages of the file included.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rich.console import Console
from rich.table import Table
from rosbags.rosbag2 import Reader

from benchmarks.recordings import (
    CLOUD_TOPIC,
    CLOUDS,
    COMPRESSIONS,
    LIST_TOPIC,
    LISTS,
    POINT,
    POINTS,
    SCANNED_BYTES,
    cloud_payload,
    write_clouds,
    write_lists,
)
from fuzz.limits import memory
from stone_recordings.bags.bag import open_bag
from stone_recordings.messages.pointcloud2 import decode_cloud, lidar_points
from stone_recordings.messages.radars.radar import decode_radar
from stone_recordings.messages.types.registry import typestore
from stone_recordings.report.scan import scan_of

PEER_LISTS = 400
CLOUD_BYTES = POINTS * POINT.itemsize
OURS, MCAP, ROSBAGS = "ours", "mcap-ros2-support", "rosbags"


@dataclass(frozen=True)
class ReadTurn:
    """The cost of one turn; `share` is the completed part of the work."""

    seconds: float
    growth_bytes: int
    share: float = 1.0


@dataclass(frozen=True)
class Work:
    """One thing to read, and the three readers' functions, which take the path and return the completed share."""

    name: str
    path: Path
    ways: Mapping[str, Callable[[Path], float]]
    turns: dict[str, list[ReadTurn]] = field(default_factory=dict)

    def best_s(self, way: str) -> float:
        """Return the seconds for the whole."""
        return min(turn.seconds / turn.share for turn in self.turns[way])


def our_clouds(path: Path) -> float:
    with open_bag(path) as bag:
        for message in bag.messages(CLOUD_TOPIC):
            lidar_points(decode_cloud(message.payload))
    return 1.0


def mcap_clouds(path: Path) -> float:
    with path.open("rb") as file:
        for decoded in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            _xyz(decoded.decoded_message.data)
    return 1.0


def _rosbags_message(payload: bytes, kind: str) -> Any:
    """Return the message; its fields have no static type."""
    return typestore().deserialize_cdr(payload, kind)


def rosbags_clouds(path: Path) -> float:
    for payload, kind in _rosbags(path):
        _xyz(_rosbags_message(payload, kind).data)
    return 1.0


def our_lists(path: Path) -> float:
    with open_bag(path) as bag:
        kind = next(topic.type for topic in bag.topics)
        detections = decode_radar(kind, bag.messages(LIST_TOPIC))
    if len(detections.range_m) != LISTS * 300:
        raise SystemExit(f"{len(detections.range_m)} detections were read, {LISTS * 300} were written")
    return 1.0


def mcap_lists(path: Path) -> float:
    with path.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages()
        for _, item in zip(range(PEER_LISTS), decoded, strict=False):
            message = item.decoded_message
            np.array([d.f_range for d in message.list_detections[: message.list_numofdetections]], np.float32)
    return PEER_LISTS / LISTS


def rosbags_lists(path: Path) -> float:
    for _, (payload, kind) in zip(range(PEER_LISTS), _rosbags(path), strict=False):
        message = _rosbags_message(payload, kind)
        np.array([d.f_range for d in message.list_detections[: message.list_numofdetections]], np.float32)
    return PEER_LISTS / LISTS


def our_scan(path: Path) -> float:
    with open_bag(path) as bag:
        scan_of(bag, lambda topic: False)
    return 1.0


def mcap_scan(path: Path) -> float:
    with path.open("rb") as file:
        for _schema, _channel, message in make_reader(file).iter_messages():
            int.from_bytes(message.data[4:8], "little")
    return 1.0


def rosbags_scan(path: Path) -> float:
    for payload, _kind in _rosbags(path):
        int.from_bytes(payload[4:8], "little")
    return 1.0


def _rosbags(path: Path) -> Iterator[tuple[bytes, str]]:
    with Reader(path) as reader:
        for connection, _time, payload in reader.messages():
            yield payload, connection.msgtype


def _xyz(data: object) -> None:
    points = np.frombuffer(data, POINT)  # type: ignore[call-overload]
    out = np.empty((len(points), 3), np.float32)
    for column, axis in enumerate("xyz"):
        out[:, column] = points[axis]


def _turn(way: Callable[[Path], float], path: Path) -> ReadTurn:
    """Run in a process for the second time, like a worker: kernels are compiled, memory was touched."""
    with get_context("spawn").Pool(1) as pool:
        return pool.apply(_measured, (way, path))


def _measured(way: Callable[[Path], float], path: Path) -> ReadTurn:
    typestore()
    lidar_points(decode_cloud(memoryview(cloud_payload(0))))
    before = memory()
    way(path)
    growth_bytes, begun_s = memory().peak - before.held, perf_counter()
    share = way(path)
    return ReadTurn(perf_counter() - begun_s, growth_bytes, share)


def works(folder: Path) -> list[Work]:
    clouds = {OURS: our_clouds, MCAP: mcap_clouds, ROSBAGS: rosbags_clouds}
    listed = [
        Work(f"xyz of {CLOUDS} clouds, {name}", write_clouds(folder / f"{name}.mcap", name), clouds)
        for name in COMPRESSIONS
    ]
    lists = {OURS: our_lists, MCAP: mcap_lists, ROSBAGS: rosbags_lists}
    listed.append(Work(f"{LISTS} detection lists", write_lists(folder / "lists.mcap"), lists))
    scans = {OURS: our_scan, MCAP: mcap_scan, ROSBAGS: rosbags_scan}
    large = write_clouds(folder / "large.mcap", "none", SCANNED_BYTES // CLOUD_BYTES)
    return [*listed, Work(f"stamps of {large.stat().st_size / 1e6:.0f} MB", large, scans)]


def table_of(measured: list[Work]) -> Table:
    table = Table(title="best of the rounds; × is the peer's time to ours")
    table.add_column("work")
    for column in (OURS, "GB/s", MCAP, "×", ROSBAGS, "×", "growth, MiB: ours", MCAP, ROSBAGS):
        table.add_column(column, justify="right")
    for work in measured:
        ours_s = work.best_s(OURS)
        rate = f"{CLOUDS * CLOUD_BYTES / ours_s / 1e9:.2f}" if "xyz" in work.name else ""
        peers = [
            text
            for way in (MCAP, ROSBAGS)
            for text in (f"{work.best_s(way) * 1e3:,.1f} ms", f"{work.best_s(way) / ours_s:,.1f}")
        ]
        growth = [f"{min(turn.growth_bytes for turn in work.turns[way]) / 2**20:.0f}" for way in work.ways]
        table.add_row(work.name, f"{ours_s * 1e3:,.1f} ms", rate, *peers, *growth)
    return table


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.read", description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    console = Console(highlight=False)
    with TemporaryDirectory() as folder:
        measured = works(Path(folder))
        for number in range(options.rounds):
            console.print(f"round {number + 1} of {options.rounds}")
            for work in measured:
                for name, way in work.ways.items():
                    work.turns.setdefault(name, []).append(_turn(way, work.path))
    Console(width=max(console.width, 150)).print(table_of(measured))
    return 0


if __name__ == "__main__":
    sys.exit(main())
