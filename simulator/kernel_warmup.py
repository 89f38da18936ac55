"""Compiled kernels of the simulator: a fifth of a second of a small world, recorded as any other."""

from pathlib import Path
from tempfile import TemporaryDirectory

from simulator.options import SimulateOptions
from simulator.pipeline import simulate

SMALL = SimulateOptions(seconds=0.2, channels=16, columns=90, camera_width_px=64, world_width_m=40.0)


def warm() -> None:
    with TemporaryDirectory(prefix="stone-warmup-") as folder:
        simulate(Path(folder) / "run.mcap", SMALL)
