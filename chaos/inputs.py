"""The input of every round: one simulated recording.

**Conventions.** The drive is slightly longer than one part of frames, and its world spans several tiles. A run
therefore has every stage of a long run, partly in parallel, in a few seconds. It uses few rays, since their number
determines the cost.
"""

from dataclasses import dataclass
from hashlib import file_digest
from pathlib import Path

from simulator.options import SimulateOptions
from simulator.pipeline import calibration_path, simulate

SEQUENCE = "chaos"
OPTIONS = SimulateOptions(seconds=6.1, seed=1, channels=4, columns=90, compression="none", world_width_m=30.0)


@dataclass(frozen=True)
class Inputs:
    """A recording and its calibration as files; `sha256` is the recording's."""

    bag: Path
    calibration: Path
    sha256: str

    @property
    def size_bytes(self) -> int:
        return self.bag.stat().st_size


def simulated(folder: Path) -> Inputs:
    """Return the recording, reusing that of an earlier run in this folder."""
    folder.mkdir(parents=True, exist_ok=True)
    bag = folder / f"{SEQUENCE}.mcap"
    if not bag.exists():
        simulate(bag, OPTIONS)
    with bag.open("rb") as file:
        return Inputs(bag, calibration_path(bag), file_digest(file, "sha256").hexdigest())
