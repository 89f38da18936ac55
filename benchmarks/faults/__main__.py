"""Every fault of the catalogue, applied to two drives, inspected and labelled: `python -m benchmarks.faults`.

The drives are a few seconds of a car's real LiDAR (left out without field data) and of the simulated rig. Outcomes are
stored as JSON in `--folder`; `--before FILE` shows an earlier run's outcomes beside them, `--only WORD` selects the
faults whose names contain the word. Exit code 1 if a fault goes through: a crash without a code, T beyond the footprint
of any pose, or a refusal or exclusion that inspection did not report.
"""

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from rich.console import Console

from benchmarks.faults.rows import outcome_of, row_of_sound
from benchmarks.faults.table import Outcomes, goes_through, shown
from testing.field_data import field_folder
from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive, kitti_drive, simulated_drive
from testing.worlds.faults.outcome import sound


def main() -> int:
    options = _options()
    options.folder.mkdir(parents=True, exist_ok=True)
    drives = _drives(options.folder)
    made = _outcomes(drives, options)
    (options.folder / "outcomes.json").write_text(json.dumps(made, indent=1) + "\n")
    before: Outcomes = json.loads(options.before.read_text()) if options.before else {}
    Console(width=200, soft_wrap=True).print(shown(made, before), markup=False, highlight=False)
    return int(any(goes_through(outcome) for of_drive in made.values() for outcome in of_drive.values()))


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-faults")
    parser.add_argument("--before", type=Path)
    parser.add_argument("--only", default="")
    parser.add_argument("--processes", type=int, default=2)
    return parser.parse_args()


def _drives(folder: Path) -> list[SoundDrive]:
    field_data = field_folder()
    drives = [simulated_drive(folder)]
    if field_data.is_dir():
        return [kitti_drive(field_data, folder), *drives]
    print(f"no field data at {field_data}: the real drive is skipped", file=sys.stderr)
    return drives


def _outcomes(drives: list[SoundDrive], options: argparse.Namespace) -> Outcomes:
    """Return the outcomes by drive and fault."""
    clean = {drive.name: sound(drive, options.folder / f"sound-{drive.name}") for drive in drives}
    runs = [(drive, fault) for drive in drives for fault in FAULTS if drive.has(fault) and options.only in fault.name]
    outcomes: dict[tuple[str, str], dict[str, Any]] = {}
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        futures = {
            pool.submit(outcome_of, drive, fault.name, clean[drive.name].grids): (drive, fault) for drive, fault in runs
        }
        for done, future in enumerate(as_completed(futures), 1):
            drive, fault = futures[future]
            outcomes[drive.name, fault.name] = future.result()
            print(f"\r{done} of {len(futures)} runs", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {
        drive.name: {"": row_of_sound(drive, clean[drive.name])}
        | {fault.name: outcomes[drive.name, fault.name] for fault in FAULTS if (drive.name, fault.name) in outcomes}
        for drive in drives
    }


if __name__ == "__main__":
    sys.exit(main())
