"""Import of a published dataset: `python -m benchmarks.dataset_import [--scenes N] [--frames N] [--index-only]`.

A dataset of the release's rig (six cameras, three radars, a LiDAR) is written as a tar, with labels of a fractal world.
Then one process indexes the tar, and another imports scene after scene, without a platform around them. Each prints
frames per CPU-second, the shares of its steps, and its peak memory.
"""

import argparse
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from hashlib import file_digest
from pathlib import Path
from resource import RUSAGE_SELF, getrusage
from tempfile import TemporaryDirectory

from benchmarks.datasets import release_sized
from services.labeler.child_answers import PublicationAnswer
from services.labeler.imports.answers import DatasetIndexAnswer
from services.labeler.imports.indexing import index_dataset
from services.labeler.imports.scene_import import import_scene
from services.labeler.imports.scene_parts import DatasetOpening, SceneOpening
from stone_datasets.classes import OWN_CLASSES
from testing.worlds.imported import NAME
from testing.worlds.published_datasets import SyntheticDataset, write_published_tar


class StepShares:
    """CPU seconds of a child between its progress reports, by reported step."""

    def __init__(self) -> None:
        self.spent, self._last = Counter[str](), time.process_time()

    def __call__(self, step: str, _done: int, _total: int) -> None:
        now = time.process_time()
        self.spent[step] += now - self._last  # type: ignore[assignment]
        self._last = now

    def summary(self) -> str:
        self("rest", 0, 0)
        total = sum(self.spent.values())
        return ", ".join(f"{step} {share / total:.0%}" for step, share in self.spent.most_common())


def index(tar: Path, folder: Path) -> None:
    with tar.open("rb") as file:
        opening = DatasetOpening(tar, NAME, file_digest(file, "sha256").hexdigest(), OWN_CLASSES)
    shares = StepShares()
    begun = time.process_time()
    answer = DatasetIndexAnswer.believed(index_dataset(opening, folder, shares))
    frames = sum(scene.frames for scene in answer.scenes)
    _say(f"index of {len(answer.scenes)} scenes", frames, (time.process_time() - begun, shares))


def scenes(tar: Path, folder: Path) -> None:
    """Import all indexed scenes; kernels are compiled, or loaded, before."""
    ordinals = range(len(list((folder / "scenes").iterdir())))
    opening = SceneOpening(tar, 0, OWN_CLASSES)
    import_scene(opening, folder, lambda *_: None)
    begun, shares, frames = time.process_time(), StepShares(), 0
    for ordinal in ordinals:
        answer = import_scene(SceneOpening(tar, ordinal, OWN_CLASSES), folder, shares)
        frames += len(PublicationAnswer.believed(answer).tokens)
    _say(f"import of {len(ordinals)} scenes", frames, (time.process_time() - begun, shares))


def _sized(count: int, frames: int) -> SyntheticDataset:
    """Return a dataset whose robot drives half a kilometre to and fro."""
    return replace(release_sized(count), scenes=count, frames=frames, longer=0, turns_after=150)


def _say(what: str, frames: int, cost: tuple[float, StepShares]) -> None:
    held_mib = getrusage(RUSAGE_SELF).ru_maxrss / 1024
    cpu_s, shares = cost
    rate = f"{cpu_s:.1f} CPU-s, {frames / cpu_s:.0f} frames per CPU-s, {held_mib:.0f} MiB at most"
    print(f"{what}: {frames} frames, {rate}; {shares.summary()}", flush=True)


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--frames", type=int, default=1183, help="per scene (default: as in the release)")
    parser.add_argument("--scenes", type=int, default=1)
    parser.add_argument("--index-only", action="store_true", help="skip the scenes")
    parser.add_argument("--measure", nargs=3, metavar=("WHAT", "TAR", "FOLDER"), help=argparse.SUPPRESS)
    given = parser.parse_args(words)
    if given.measure:
        what, tar, folder = given.measure
        (index if what == "index" else scenes)(Path(tar), Path(folder))
        return
    with TemporaryDirectory() as folder:
        what = _sized(given.scenes, given.frames)
        if given.index_only:
            what = replace(what, labels=(b"never opened",))
        tar = write_published_tar(Path(folder) / "dataset.tar", what)
        print(f"{tar.stat().st_size / 2**20:.0f} MiB", flush=True)
        for step in ("index",) if given.index_only else ("index", "scenes"):
            command = [sys.executable, "-m", "benchmarks.dataset_import", "--measure", step, str(tar), folder]
            subprocess.run(command, check=True)


if __name__ == "__main__":
    main(sys.argv[1:])
