"""How long a short command takes from its start to its end: `python -m benchmarks.starts [--rounds 5]`.

Each command runs in a process of its own, in turns with the others; a figure is the best of its rounds, wall and
processor seconds (all processes, those of labelling too). The recordings are simulated once and kept in `--folder`:
400 MB, of which `stone inspect` reads every chunk, and the 20 s that a demo labels. Kernels come from numba's cache, as
`make install` leaves it, and files from the page cache: the first round fills both. Beside them the library of commands
alone, below which no command can start.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.processes import adopt_orphans, reap_orphans

LIBRARY = "typer and rich alone"
INSPECTED_S, LABELLED_S = 40, 20


@dataclass(frozen=True)
class Start:
    """What one run of a command took."""

    wall_s: float
    cpu_s: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-bench")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    adopt_orphans()
    with tempfile.TemporaryDirectory() as out:
        commands = commands_at(options.folder, Path(out))
        rounds = [{name: measured(command) for name, command in commands.items()} for _ in range(options.rounds)]
    show(best_of(rounds))


def commands_at(folder: Path, out: Path) -> Mapping[str, Sequence[str | Path]]:
    """What is measured, its recordings made; labels go to `out`."""
    inspected, labelled = simulated(folder, INSPECTED_S), simulated(folder, LABELLED_S)
    calibration = labelled.with_name(f"{labelled.stem}.calibration.yaml")
    return {
        LIBRARY: (sys.executable, "-c", "import typer, typer.rich_utils"),
        "stone --help": (stone(), "--help"),
        "stone inspect": (stone(), "inspect", inspected),
        "stone label": (stone(), "label", labelled, "--calibration", calibration, "-o", out / "labels"),
    }


def simulated(folder: Path, seconds: int) -> Path:
    """A recording of the usual rig that lasts so long, from an earlier run where there is one."""
    bag = folder / f"starts-{seconds}.mcap"
    if not bag.exists():
        subprocess.run([stone(), "simulate", bag, "--seconds", str(seconds)], check=True)
    return bag


def stone() -> Path:
    return Path(sys.executable).with_name("stone")


def measured(command: Sequence[str | Path]) -> Start:
    """One run, and the processor time of whatever it started."""
    begin, before = time.perf_counter(), _children_s()
    subprocess.run(command, check=True, capture_output=True)
    wall_s = time.perf_counter() - begin
    reap_orphans()  # the fork server of labelling
    return Start(wall_s, _children_s() - before)


def best_of(rounds: Sequence[Mapping[str, Start]]) -> dict[str, Start]:
    """The least of each figure."""
    return {
        name: Start(min(one[name].wall_s for one in rounds), min(one[name].cpu_s for one in rounds))
        for name in rounds[0]
    }


def show(found: Mapping[str, Start]) -> None:
    table = Table("command", "wall s", "CPU s", title=f"short commands, {os.cpu_count()} cores")
    for name, start in found.items():
        table.add_row(name, f"{start.wall_s:.2f}", f"{start.cpu_s:.2f}")
    Console().print(table)


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


if __name__ == "__main__":
    main()
