"""The index holds columns: a datum costs bytes, not dictionaries.

The figures of a whole release: `make bench-datasets`.
"""

import tracemalloc
from pathlib import Path

from stone_datasets.reading import read_dataset
from testing.worlds.published_datasets import SyntheticDataset, write_published_tar

MOST_BYTES_A_DATUM = 1000  # at its peak, its frame's share with it; two rows as dictionaries are 2,000


def peak_bytes(path: Path) -> int:
    tracemalloc.start()
    try:
        read_dataset(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_memory_grows_by_bytes_a_datum(tmp_path: Path) -> None:
    short = write_published_tar(tmp_path / "short.tar", SyntheticDataset(scenes=4, frames=100))
    long = write_published_tar(tmp_path / "long.tar", SyntheticDataset(scenes=4, frames=400))
    read_dataset(short)  # what is cached, regular expressions and the like
    data = 4 * (400 - 100) * len(SyntheticDataset().sensors)
    assert peak_bytes(long) - peak_bytes(short) < MOST_BYTES_A_DATUM * data
