"""A scan for stamps touches the heads of messages and nothing else: its cost does not grow with their size."""

import time
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from stone_recordings.bags.bag import open_bag
from stone_recordings.clocks.measurement import kept_bytes
from stone_recordings.report.scan import scan_of
from tests.stone_recordings.clocks.streams import MS, every
from tests.stone_recordings.writing import NEBULA, POINT_CLOUD, CloudText, Recorded, cloud_payload, sweep, write_mcap

CLOUDS = 12


def _least_cpu_s(work: Callable[[], object]) -> float:
    spent = []
    for _round in range(5):
        begun = time.process_time()
        work()
        spent.append(time.process_time() - begun)
    return min(spent)


@pytest.mark.parametrize("use_chunking", [True, False])
def test_a_scan_costs_a_fraction_of_reading_the_recording(tmp_path: Path, use_chunking: bool) -> None:
    """Opening included; against one CRC-32 of the file's bytes, the least that whoever reads them all can do."""
    points = sweep(NEBULA, 100_000)
    stamps_ns = every(100 * MS, CLOUDS)
    messages = [
        Recorded("/lidar", POINT_CLOUD, stamp_ns, cloud_payload(points, CloudText(stamp_ns=stamp_ns)))
        for stamp_ns in stamps_ns.tolist()
    ]
    path = write_mcap(tmp_path / "run.mcap", messages, use_chunking=use_chunking, chunk_size=1 << 20)

    def scan() -> list[int]:
        with open_bag(path) as bag:
            return list(scan_of(bag, kept_bytes).stamps_ns["/lidar"].tolist())

    assert scan() == stamps_ns.tolist()
    assert _least_cpu_s(scan) < _least_cpu_s(lambda: zlib.crc32(path.read_bytes())) / 2
