"""Remains of movers in the labels: `python -m benchmarks.movers [--rates 1 2 5 10 20] [--seeds 1 2 3]`.

Per seed and LiDAR rate a drive of 20 s (64 × 900 rays) is simulated twice, with three walkers and two vehicles and
without movers, and labelled with profile `paper`. Labelling does not use the truth. Worlds, labels and figures are
stored in `--folder`; `--table` prints the stored figures again.
"""

import argparse
import json
import tempfile
from dataclasses import asdict, replace
from pathlib import Path

from rich.console import Console
from rich.table import Table

from benchmarks.movers.counts import MoverCounts, mover_counts
from benchmarks.truth.__main__ import simulated
from benchmarks.truth.checks import Drive
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from simulator.options import LIDAR_HZ, SimulateOptions, Traffic
from simulator.scenery.movers import movers_of

WORKERS = 2
GOAL_LOST = 0.005


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rates", type=int, nargs="+", default=LIDAR_HZ, help="sweeps per second")
    parser.add_argument("--seeds", type=int, nargs="+", default=(1, 2, 3))
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--channels", type=int, default=64)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-movers")
    parser.add_argument("--table", action="store_true", help="only print stored figures")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    counts = dict[tuple[int, int], MoverCounts]()
    for rate in options.rates:
        for seed in options.seeds:
            world = SimulateOptions(options.seconds, seed, options.channels, cameras=False, lidar_hz=rate)
            file = options.folder / f"figures-{_stem(world)}.json"
            if not options.table:
                file.write_text(json.dumps(asdict(measured(options.folder, world))) + "\n", "utf-8")
            counts[rate, seed] = MoverCounts(**json.loads(file.read_text("utf-8")))
    _show(counts, options.rates, options.seeds)


def _stem(world: SimulateOptions) -> str:
    return f"{world.seed}-{world.channels}x{world.lidar_hz}Hz-{world.seconds:g}s"


def measured(folder: Path, world: SimulateOptions) -> MoverCounts:
    """Return the counts of this world with its movers; its drives and labels stay in the folder."""
    busy = _labelled(folder, replace(world, traffic="busy"))
    truth = busy[0].truth
    movers = movers_of(replace(world, traffic="busy"), truth.trajectory, truth)
    return mover_counts(busy, _labelled(folder, replace(world, traffic="none")), movers)


def _labelled(folder: Path, world: SimulateOptions) -> tuple[Drive, Path]:
    """Return the drive of these options and its labels."""
    name: Traffic = world.traffic
    drive = simulated(folder / f"{name}-{_stem(world)}.mcap", world)
    labels = folder / f"labels-{name}-{_stem(world)}"
    label(drive.sequence, drive.sweeps, labels, LabelOptions(parameters_for("paper"), WORKERS))
    return drive, labels


def _show(counts: dict[tuple[int, int], MoverCounts], rates: list[int], seeds: list[int]) -> None:
    table = Table(title="voxels left by movers | of what stands and was seen, lost | voxels of the parked vehicle")
    table.add_column("sweeps per second")
    for seed in seeds:
        table.add_column(f"world {seed}", justify="right")
    for rate in rates:
        table.add_row(str(rate), *(_cell(counts[rate, seed]) for seed in seeds))
    Console().print(table)


def _cell(counts: MoverCounts) -> str:
    ratio = counts.lost / max(counts.standing, 1)
    mark = " !" if counts.left or ratio > GOAL_LOST else ""
    return f"{counts.left} | {ratio:.2%} | {counts.parked}{mark}"


if __name__ == "__main__":
    main()
