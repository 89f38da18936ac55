"""Import of a dataset of the release's size while the platform is killed: `python -m benchmarks.release_import`.

A tar of 43 scenes, 50,878 frames and ten sensors (labels of a fractal world repeat) is imported twice by the processes
of `stone serve`. The first import is undisturbed with a quarter of the frames; the second is whole with `--kills` kills
(−9) spread over the frames. A kill hits the whole platform or one worker process. The program prints frames per second
and the peak memory of any process for both imports. It checks that every frame exists once with the dataset's bytes,
and compares the scores of a phase of the imported splits with NumPy's counts.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.datasets import FRAMES, SCENES, release_sized
from benchmarks.release_import.run import ImportMeasurement, administrator, imported
from benchmarks.release_import.scoring import scored
from benchmarks.release_import.verification import verified
from testing.stone_serve import serving
from testing.worlds.published_datasets import SyntheticDataset, write_published_tar

KILLS, TEST_SCENES, VAL_SCENES = 20, 2, 2
SMALLER = 4
TURNS_AFTER = 150  # frames: the robot drives half a kilometre to and fro, as in `benchmarks.dataset_import`


def dataset_of(scenes: int, count: int) -> SyntheticDataset:
    """Return a dataset of `count` frames in `scenes` scenes: the last are test, in another place, the ones before val,
    the others train.
    """
    each, longer = divmod(count, scenes)
    dataset = replace(release_sized(count), scenes=scenes, frames=each, longer=longer, turns_after=TURNS_AFTER)
    train, val, test = scenes - TEST_SCENES - VAL_SCENES, scenes - TEST_SCENES, scenes
    names = dataset.names
    splits = {"train": names[:train], "val": names[train:val], "test": names[val:test]}
    return replace(dataset, splits=splits, locations=("quarry",) * val + ("lake",))


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--kills", type=int, default=KILLS)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="work folder (about 20 GB)")
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        for name, count, kills in (("smaller", given.frames // SMALLER, 0), ("whole", given.frames, given.kills)):
            measure(Path(folder) / name, dataset_of(given.scenes, count), kills)


def measure(folder: Path, dataset: SyntheticDataset, kills: int) -> None:
    """Import the dataset into a new platform; with kills also verify it and score against it."""
    folder.mkdir()
    begun = time.perf_counter()
    tar = write_published_tar(folder / "field.tar", dataset)
    written = f"{tar.stat().st_size / 1e9:.2f} GB written in {time.perf_counter() - begun:.0f} s"
    print(f"{dataset.scenes} scenes, {sum(map(dataset.length, range(dataset.scenes)))} frames, {written}", flush=True)
    made = imported(folder / "data", tar, kills)
    show(made)
    if kills:
        with serving(folder / "data") as running, administrator(running) as api:
            print(verified(api, dataset), flush=True)
            print(scored(api, dataset, folder), flush=True)


def show(made: ImportMeasurement) -> None:
    held = ", ".join(f"{name} {mib:.0f}" for name, mib in sorted(made.most_mib.items()))
    rate = f"{made.frames} frames in {made.wall_s:.0f} s ({made.frames / made.wall_s:.0f} frames/s)"
    print(f"sent in {made.sent_s:.0f} s; imported: {rate}, killed {made.kills} times", flush=True)
    print(f"peak MiB of a process: {held}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
