"""Wrong mounts corrected by `--ground auto`: `python -m benchmarks.mounts`.

Three simulated drives through worlds of their own, and a car's real drive (left out without field data), are each
labelled with the right mount and with twelve wrong ones. The tables show the error of the corrected mount, and the IoU
of its labels with the labels of the right mount, with the calibration as given and with `--ground auto`. Rows are
stored as JSON in `--folder`; `--only WORD` selects the drives whose names contain the word.
"""

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.mounts.rows import WRONG, Grids, MountDrive, distances, row_of
from benchmarks.mounts.table import shown
from services.ingest.pipeline import Ground, SynchroniseOptions
from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate
from testing.field_data import field_folder
from testing.worlds.faults.drive import EXAMPLE, KITTI
from testing.worlds.faults.outcome import labelled

SEEDS, SECONDS = (1, 3, 5), 10.0
GROUNDS: tuple[Ground, ...] = ("given", "auto")


def main() -> None:
    options = _options()
    options.folder.mkdir(parents=True, exist_ok=True)
    drives = [drive for drive in _drives(options.folder) if options.only in drive.name]
    made = {drive.name: _rows(drive, options) for drive in drives}
    (options.folder / "mounts.json").write_text(json.dumps(made, indent=1) + "\n")
    Console(width=200, soft_wrap=True).print(shown(made), markup=False, highlight=False)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-mounts")
    parser.add_argument("--only", default="")
    parser.add_argument("--processes", type=int, default=2)
    return parser.parse_args()


def _drives(folder: Path) -> list[MountDrive]:
    drives = [_simulated(folder, seed) for seed in SEEDS]
    recording = field_folder() / KITTI
    if recording.exists():
        return [*drives, MountDrive("kitti", recording, EXAMPLE)]
    print(f"no {recording}: the real drive is skipped", file=sys.stderr)
    return drives


def _simulated(folder: Path, seed: int) -> MountDrive:
    """Return the drive, from an earlier run if it exists."""
    bag = folder / f"world-{seed}.mcap"
    if not bag.exists():
        simulate(bag, SimulateOptions(SECONDS, seed, channels=64, columns=450, cameras=False))
    return MountDrive(f"world {seed}", bag, calibration_path(bag))


def _rows(drive: MountDrive, options: argparse.Namespace) -> dict[str, Any]:
    """Return the rows by wrong mount; "" is the right one, with `--ground auto`."""
    sound = {
        ground: labelled(
            drive.bag, drive.rig(), options.folder / f"{drive.name}-{ground}", SynchroniseOptions(ground=ground)
        )
        for ground in GROUNDS
    }
    grids: dict[str, Grids] = {ground: made.grids for ground, made in sound.items()}
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        futures = {wrong.name: pool.submit(row_of, drive, number, grids) for number, wrong in enumerate(WRONG)}
        return {"": distances(drive, sound["auto"])} | {name: future.result() for name, future in futures.items()}


if __name__ == "__main__":
    main()
