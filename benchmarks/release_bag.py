"""A bag as long as the release's longest, labelled at its grid: `python -m benchmarks.release_bag`.

Bags of 445 and 1,781 frames are simulated and written like the release's, topic after topic. Each frame has a sweep of
16 × 300 rays and six small raw images, 10 frames per second. `stone label --grid release --ground auto` labels each. A
line for each bag has seconds, processor seconds, frames per second of each and the peak resident memory of any process.
It also has the bytes of the labels and the load of the machine. Memory must not grow with the length.
"""

import argparse
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.processes import adopt_orphans, reap_orphans
from benchmarks.release_twin.stages import HEAD, stage
from simulator.options import SimulateOptions
from stone_base.label_grid import GRIDS
from stone_files.dataset_layouts import RELEASE_FACTS
from testing.stone_serve import STONE
from testing.worlds.release_bags import release_calibration, write_release_bag

LONGEST, HZ = RELEASE_FACTS.frames_of_longest_bag, 10


def options_of(frames: int) -> SimulateOptions:
    """Return options for a drive of `frames` sweeps."""
    return SimulateOptions(frames / HZ + 0.05, channels=16, columns=300, camera_width_px=64, compression="none")


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, nargs="+", default=[LONGEST // 4, LONGEST])
    parser.add_argument("--grid", choices=tuple(GRIDS), default="release")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="work folder (1 GB)")
    given = parser.parse_args(words)
    adopt_orphans()
    print(HEAD, flush=True)
    for frames in given.frames:
        with tempfile.TemporaryDirectory(dir=given.folder) as folder:
            measure(Path(folder), frames, given.grid)


def measure(folder: Path, frames: int, grid: str) -> None:
    """Write a bag below the folder and label it."""
    bag, out = folder / "bag", folder / "labels"
    with stage("bag written", frames, bag):
        write_release_bag(bag, options_of(frames))
    words = ("--calibration", str(release_calibration(bag)), "--ground", "auto", "--grid", grid, "-o", str(out))
    with stage(f"stone label --grid {grid}", frames, out):
        subprocess.run([*STONE, "label", str(bag), *words], check=True, stdout=subprocess.DEVNULL)
        reap_orphans()


if __name__ == "__main__":
    main(sys.argv[1:])
