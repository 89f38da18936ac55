"""Calibration of the voxels' confidence: `python -m benchmarks.confidence [--fit]`.

Voxels of drives with known truth are grouped by their confidence: in tenths of the voxels, and in tenths of the
probability. The drives of `UNSEEN` were not used for `stone.labels.confidence_curves`; `--fit` fits the curves to the
drives of `TUNED` and prints them. Recordings and voxels are stored in `--folder`; a drive takes about a minute.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from benchmarks.confidence.fit import as_source, fitted
from benchmarks.confidence.reliability import Reliability, reliability_of
from benchmarks.confidence.voxels import Array, OutsideVoxels, SimulatedVoxels, kept_voxels
from simulator.options import SimulateOptions
from stone.labels.confidence import drivable_log_odds, right_probability
from testing.outside.drive import OutsideDrive

LOW = "mount 10 cm low"
Source = OutsideVoxels | SimulatedVoxels


def _analytic(world: str, channels: int, seed: int, fault: str = "sound") -> Source:
    return OutsideVoxels(OutsideDrive(world, channels, seed), fault)


def _simulated(seed: int, channels: int, *, noisy: bool = False, beside: bool = False) -> Source:
    options = SimulateOptions(30.0, seed, channels, cameras=False, range_noise=noisy, beside_track=beside)
    return SimulatedVoxels(options)


TUNED: tuple[Source, ...] = (
    *(_analytic(world, 64, 1, fault) for world in ("hills", "slopes") for fault in ("sound", "rain", LOW)),
    *(_analytic(world, 16, 3) for world in ("hills", "slopes")),
    *(_simulated(seed, 64, beside=True) for seed in (1, 2)),
    _simulated(4, 64),
    _simulated(6, 32, noisy=True, beside=True),
    _simulated(7, 16, noisy=True),
)
UNSEEN: tuple[Source, ...] = (
    *(_analytic("forest", 64, 1, fault) for fault in ("sound", "rain", LOW, "RTK float 10 cm", "poses 50 ms late")),
    _analytic("forest", 16, 1),
    _analytic("forest", 64, 2),
    _simulated(3, 64, beside=True),
    _simulated(5, 16, noisy=True),
    _simulated(8, 64, noisy=True, beside=True),
    _simulated(9, 64),
    _simulated(10, 32, noisy=True),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "stone-confidence")
    parser.add_argument("--fit", action="store_true", help="fit the curves again and print them")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    if options.fit:
        print(as_source(fitted([kept_voxels(source, options.folder) for source in TUNED])))
        return
    table = Table("drive", "voxels", "tenths of voxels: worst", "bins of probability: worst", "in the lowest tenth")
    unseen = list[tuple[Array, NDArray[np.bool_], Array]]()
    for kind, sources in (("tuned", TUNED), ("unseen", UNSEEN)):
        for source in sources:
            judged = _judged(source, options.folder)
            unseen += [judged] if kind == "unseen" else []
            table.add_row(f"{kind}: {source.name}", *_cells(reliability_of(*judged)))
    together = reliability_of(*map(np.concatenate, zip(*unseen, strict=True)))
    table.add_row("all unseen, with equal weights", *_cells(together))
    Console(width=160).print(table)
    for number, (claimed, right, voxels) in enumerate(together.by_probability):
        print(
            f"{10 * number:3} to {10 * number + 10:3} %: {voxels:9,} voxels, claimed {claimed:6.1%}, right {right:6.1%}"
        )


def _judged(source: Source, folder: Path) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return the confidence of a drive's voxels (K,), whether the label is right, and the weights, which sum to 1."""
    voxels = kept_voxels(source, folder)
    log_odds = drivable_log_odds(dict(zip(voxels.names, voxels.properties.T, strict=True)))
    confidence = right_probability(log_odds, ~voxels.is_kept)
    return confidence, voxels.is_kept == voxels.is_drivable, voxels.weight / voxels.weight.sum()


def _cells(reliability: Reliability) -> tuple[str, ...]:
    low = f"{100 * reliability.lowest[0]:.1f} % claimed, {100 * reliability.lowest[1]:.1f} % right"
    return (
        f"{reliability.voxels:,}",
        f"{100 * reliability.tenths:.1f} points",
        f"{100 * reliability.bins:.0f} points",
        low,
    )


if __name__ == "__main__":
    main()
