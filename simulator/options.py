"""What to simulate: one frozen value, checked when it is made.

**Conventions.** Equal options give equal bytes: the seed draws the world, the noise and the jitter, and nothing reads
the clock.
"""

from dataclasses import dataclass
from typing import Literal

from stone.errors import StoneError

Compression = Literal["none", "lz4", "zstd"]
MAX_CHANNELS = 512
MAX_COLUMNS = 7200
MAX_SECONDS = 3600.0


class SimulationOptionError(StoneError):
    """An option lies outside what the simulated rig can do."""

    code = "bad_simulation_option"

    def __init__(self, name: str, value: object, limit: str) -> None:
        super().__init__(f"{name} is {value!r}; it must be {limit}")


@dataclass(frozen=True)
class SimulateOptions:
    """`channels` × `columns` rays a sweep at 10 Hz; the world is as long as the drive and `world_width_m` wide.

    lz4 by default: packet stamps, rings and missing returns repeat, so it nearly halves the bag at no time that can be
    measured; zstd is smaller still, but costs more to write and twice as much to read.
    """

    seconds: float = 20.0
    seed: int = 1
    channels: int = 64
    columns: int = 900
    cameras: bool = True
    camera_width_px: int = 480
    compression: Compression = "lz4"
    world_width_m: float = 110.0

    def __post_init__(self) -> None:
        _within("seconds", self.seconds, 0.2, MAX_SECONDS)
        _within("seed", self.seed, 0, 2**31)
        _within("channels", self.channels, 2, MAX_CHANNELS)
        _within("columns", self.columns, 12, MAX_COLUMNS)
        _within("camera_width_px", self.camera_width_px, 32, 4096)
        _within("world_width_m", self.world_width_m, 30.0, 400.0)
        if self.compression not in ("none", "lz4", "zstd"):
            raise SimulationOptionError("compression", self.compression, "none, lz4 or zstd")


def _within(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise SimulationOptionError(name, value, f"from {low:g} to {high:g}")
