"""Reading a published dataset of the release's size: `python -m benchmarks.datasets [--frames N] [--tar]`.

The generated dataset has 43 sequences, 50,878 frames and ten sensors: labels of a fractal world repeat, hard-linked in
a folder, copied in a tar. Then two processes read it: the index alone, and everything (`stone check`). Each prints
seconds, frames per second and its peak memory.
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.grids import frames, seen_by_lidar
from stone_datasets.reading import check_dataset, read_dataset
from stone_files.npz import npz_bytes
from testing.worlds.published_datasets import SyntheticDataset, write_published, write_published_tar
from testing.worlds.small_export import CAMERAS

SCENES, FRAMES, KINDS_OF_LABELS = 43, 50_878, 8
RADARS = ("RADAR_FRONT", "RADAR_LEFT", "RADAR_RIGHT")


def release_sized(count: int) -> SyntheticDataset:
    """Return a dataset of `count` frames in 43 scenes."""
    labels = []
    for truth, _ in frames(KINDS_OF_LABELS):
        seen = seen_by_lidar(truth).astype(np.uint8)
        labels.append(npz_bytes({"semantics": truth, "mask_lidar": seen, "mask_camera": seen}))
    each, longer = divmod(count, SCENES)
    return SyntheticDataset(SCENES, each, longer, CAMERAS, RADARS, labels)


def measure(path: Path, what: str) -> None:
    """Read the dataset in this process and print the cost."""
    begun = time.perf_counter()
    if what == "index":
        count = sum(map(len, read_dataset(path).sequences))
    else:
        check = check_dataset(path)
        if check.contents is None:
            raise SystemExit("\n".join(map(str, check.faults.found)))
        count = check.contents.labelled
    seconds = time.perf_counter() - begun
    cpu_s = time.process_time()
    held = getrusage(RUSAGE_SELF).ru_maxrss / 1024
    rate = f"{seconds:.1f} s ({cpu_s:.1f} CPU-s), {count / seconds:.0f} frames/s"
    print(f"{what}: {count} frames, {rate}, {held:.0f} MiB at most")


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--tar", action="store_true", help="as a tar of a few gigabytes")
    parser.add_argument("--measure", nargs=2, metavar=("PATH", "WHAT"), help=argparse.SUPPRESS)
    given = parser.parse_args(words)
    if given.measure:
        measure(Path(given.measure[0]), given.measure[1])
        return
    with TemporaryDirectory() as folder:
        begun, dataset = time.perf_counter(), release_sized(given.frames)
        path = Path(folder) / ("dataset.tar" if given.tar else "dataset")
        (write_published_tar if given.tar else write_published)(path, dataset)
        print(f"written in {time.perf_counter() - begun:.0f} s", flush=True)
        for what in ("index", "check"):
            command = [sys.executable, "-m", "benchmarks.datasets", "--measure", str(path), what]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
