"""Inputs of a row: its sensors, the number of earlier sweeps, and the size of images."""

from dataclasses import dataclass
from typing import Literal

# Voxels that a benchmark counts: all voxels, with unobserved voxels free; or voxels that a ray of the run reached or
# passed.
CountedVoxels = Literal["all", "observed"]
Modality = Literal["C", "L", "R", "C+L", "C+R", "L+R", "C+L+R"]


@dataclass(frozen=True)
class InputConfig:
    """`image_size_px` is (height, width) of the network's images; `lidar_sweeps`, `radar_scans` include the frame's
    own.

    Earlier ones are at most `earliest_s` older than the frame, never newer. `channels` are the cameras in the network's
    order; frames without one of them are refused.
    """

    modality: Modality
    image_size_px: tuple[int, int] = (896, 1600)
    channels: tuple[str, ...] = (
        "CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT",
    )  # fmt: skip
    lidar_sweeps: int = 10
    radar_scans: int = 5
    earliest_s: float = 1.5
    with_depth: bool = False

    def __post_init__(self) -> None:
        refuse_below_one(self, "lidar_sweeps", "radar_scans")

    def sees(self, sensor: Literal["C", "L", "R"]) -> bool:
        return sensor in self.modality.split("+")


def refuse_below_one(config: object, *names: str) -> None:
    """Raise `ValueError` if one of these fields is less than 1."""
    low = next((name for name in names if getattr(config, name) < 1), None)
    if low is not None:
        raise ValueError(f"{low} is {getattr(config, low)}, but must be at least 1")
