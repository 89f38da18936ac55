"""A recovery costs a window of the original and a chunk of the copy, whatever the file says of itself."""

import os
import struct
import subprocess
import sys
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import numpy as np
import pytest
import zstandard

from stone_recordings.bags.mcap.records import MAGIC
from tests.stone_recordings.writing import Recorded, write_mcap

ROOT = Path(__file__).resolve().parents[4]
GROWTH = """
import resource, sys
from pathlib import Path
from stone_recordings.bags.mcap.records import MAGIC
from stone_recordings.bags.recovery.recovery import recover
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
recovery = recover(Path(sys.argv[1]), Path(sys.argv[2]))
sys.stdout.write(f"{recovery.messages} {(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024}")
"""


def test_a_large_file_is_recovered_in_little_memory(tmp_path: Path) -> None:
    """120 MB; a window of the mapped original and one chunk of the copy are in memory at a time."""
    payload = b"\x00\x01\x00\x00" + np.random.default_rng(0).bytes(2_000_000)
    messages = [Recorded("/a", "sensor_msgs/msg/Imu", row, payload) for row in range(60)]
    path = write_mcap(tmp_path / "run.mcap", messages, chunk_size=4 << 20)
    command = [sys.executable, "-c", GROWTH, str(path), str(tmp_path / "out.mcap")]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=300)
    count, growth_bytes = (int(word) for word in done.stdout.split())
    assert count == 60
    assert growth_bytes < 64 * 2**20


@pytest.mark.parametrize("compression", [b"lz4", b"zstd"])
def test_a_chunk_without_end_costs_no_more_than_its_pieces(tmp_path: Path, compression: bytes) -> None:
    """The last whole messages of a chunk that claims all of a file of 1.5 GB, which is a hole."""
    packed = {b"lz4": lz4.frame.compress, b"zstd": zstandard.compress}[compression](bytes(1000))
    head = struct.pack("<BQQQQII", 6, 1 << 40, 0, 0, 1 << 40, 0, len(compression)) + compression
    path = tmp_path / "run.mcap"
    path.write_bytes(MAGIC + head + struct.pack("<Q", 1 << 40) + packed)
    os.truncate(path, 1_500_000_000)
    command = [sys.executable, "-c", GROWTH, str(path), str(tmp_path / "out.mcap")]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=300)
    count, growth_bytes = (int(word) for word in done.stdout.split())
    assert count == 0
    assert growth_bytes < 64 * 2**20
