"""The architectures that there are: a configuration says which, and this is where it becomes a module."""

from typing import Any, assert_never

from baselines.models.occupancy_model import OccupancyModel
from baselines.models.openocc import OpenOcc
from baselines.models.openocc_config import OpenOccConfig

ModelConfig = OpenOccConfig


def build_model(config: ModelConfig) -> OccupancyModel[Any]:
    """The model of a configuration, its weights drawn by torch's generator."""
    match config:
        case OpenOccConfig():
            return OpenOcc(config)
        case _:
            assert_never(config)
