"""An analytic drive from end to end: cast once, cached on disk, recorded with a fault.

**Conventions.** The folder keeps the ideal ranges of a drive in a file named after the drive and a hash of its world,
so a changed world is cast again.
"""

from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path

import numpy as np

from testing.outside.faults import FAULTS
from testing.outside.lidar import Lidar, ideal_ranges
from testing.outside.recording import Recordable, recordable, write_recording
from testing.outside.truth import Truth
from testing.outside.worlds import World, world_of


@dataclass(frozen=True)
class OutsideDrive:
    """A drive: the world's name, its seed, the LiDAR's channels, and the duration."""

    world_name: str
    channels: int
    seed: int = 1
    seconds: float = 15.0
    columns: int = 900

    @property
    def name(self) -> str:
        return f"{self.world_name}-{self.seed}-{self.channels}-{self.seconds:g}s"

    @property
    def world(self) -> World:
        return self.truth.world

    @property
    def truth(self) -> Truth:
        return _truth_of(self.world_name, self.seed, self.seconds)

    def ideal(self, folder: Path) -> Recordable:
        """Return the ideal data; cast the ranges if they are not in the folder yet."""
        kept, lidar = folder / f"{self.name}-{self._world_hash()}.ranges.npy", Lidar(self.channels, self.columns)
        if not kept.exists():
            folder.mkdir(parents=True, exist_ok=True)
            part = folder / f"{self.name}.part.npy"
            np.save(part, ideal_ranges(self.world, lidar, self.seed))
            part.rename(kept)
        return recordable(self.world.track, lidar, np.load(kept))

    def _world_hash(self) -> str:
        parts = (*self.world.ground, self.world.solids)
        return sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:8]

    def with_fault(self, folder: Path, fault: str) -> Recordable:
        """Return the data with the fault."""
        return FAULTS[fault](self.ideal(folder), np.random.default_rng([self.seed, *fault.encode()]))

    def record(self, folder: Path, fault: str, into: Path | None = None) -> tuple[Path, Path, Recordable]:
        """Write the recording and calibration into a folder; return both paths and their data."""
        data = self.with_fault(folder, fault)
        return *write_recording(data, into or folder / f"{self.name} {fault}", self.seed), data


@cache  # shared by drives with other LiDARs and faults
def _truth_of(world_name: str, seed: int, seconds: float) -> Truth:
    return Truth(world_of(world_name, seed, seconds))
