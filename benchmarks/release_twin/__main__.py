"""A twin of the release through all stages of a platform: `python -m benchmarks.release_twin [--grid paper]`.

A ZIP of the release's layout (`--grid paper`: the paper's) contains 279 scenes of 200 frames, nine of each drive, with
six cameras and sweeps of 6,000 shots. `stone check` reads the ZIP. Then the processes of `stone serve` import it, split
it by drives, publish it, open a hidden phase, create inputs, score a baseline from them and export a scene. A line for
each stage has seconds, processor seconds, frames per second of each and the peak resident memory of any process. It
also has the platform's stored bytes and the load of the machine.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.release_import.run import administrator
from benchmarks.release_twin.stages import HEAD, stage
from benchmarks.release_twin.way import Way, cpu_by_kind
from stone_files.dataset_layouts import LAYOUTS, RELEASE_FACTS
from testing.stone_serve import serving
from testing.worlds.released_datasets import CAMERAS, ReleasedDataset, write_released_zip

DRIVE_SCENES, TURNS_AFTER, APART_M = 9, 60, 5_000.0
REACH_M = 17.0  # a frame of the release has labels in 15 % of its grid's area, in 10,691 voxels at most


def twin_of(scenes: int, frames: int, grid: str) -> ReleasedDataset:
    """Return the twin in the layout of this grid; a scene's 75 m are driven to and fro."""
    shape = {"drive_scenes": DRIVE_SCENES, "turns_after": TURNS_AFTER, "apart_m": APART_M, "reach_m": REACH_M}
    return ReleasedDataset(scenes, frames, LAYOUTS[grid], CAMERAS, **shape)  # type: ignore[arg-type]


def main(words: Sequence[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=RELEASE_FACTS.scenes, help="at least 27 (three drives)")
    parser.add_argument("--frames", type=int, default=RELEASE_FACTS.frames_a_scene, help="per scene, at least 23")
    parser.add_argument("--grid", choices=("release", "paper"), default="release")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()), help="work folder (30 GB)")
    parser.add_argument("--zip", type=Path, help="path of the ZIP; written if it is missing")
    parser.add_argument("--no-check", action="store_true", help="skip `stone check`")
    parser.add_argument("--no-playback", action="store_true", help="create no images and sweeps for the viewer")
    given = parser.parse_args(words)
    what = twin_of(given.scenes, given.frames, given.grid)
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        way = Way(what, given.zip or Path(folder) / "twin.zip", Path(folder), not given.no_playback)
        print(f"{given.scenes} scenes of {given.frames} frames at the grid {what.layout.grid}\n{HEAD}", flush=True)
        if not way.path.exists():
            with stage("written", way.frames(what.scenes), way.data):
                write_released_zip(way.path, what)
        print(f"  {way.path.stat().st_size / 1e9:.2f} GB", flush=True)
        if not given.no_check:
            way.check()
        extra = {"STONE_VIEWING__MAKES_PLAYBACK": "false"} if given.no_playback else {}
        with serving(way.data, **extra) as running, administrator(running) as api:
            way.go(api)
        print("\n".join(cpu_by_kind(way.data)))


if __name__ == "__main__":
    main(sys.argv[1:])
