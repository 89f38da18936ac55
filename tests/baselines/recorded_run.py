"""A run that never learned and yet says all four classes, and a recording for it: predicting needs no more."""

from pathlib import Path

import torch
from torch import nn

from baselines.augment import NO_AUGMENTATION
from baselines.checkpoint import Position, WeightsProvenance, write_weights
from baselines.inputs import InputConfig
from baselines.lattice import VoxelLattice
from baselines.models.column_net import ColumnNet
from baselines.models.column_net_config import ColumnNetConfig
from baselines.row_config import RowConfig
from baselines.run_folder import write_run_row
from simulator.options import SimulateOptions

DRIVE = SimulateOptions(seconds=0.8, seed=3, channels=16, columns=240, camera_width_px=96, world_width_m=60.0)
PART = VoxelLattice((-6.4, -6.4, -2.0), (0.2, 0.2, 0.2), (64, 64, 32))
NET = ColumnNetConfig(
    lattice=PART, heights=20, heights_below=5, widths=(8, 12), depths=(1, 1), head_channels=4, image_channels=4,
    image_pool=1,
)  # fmt: skip
ROW = RowConfig("tiny", "Tiny", "a test", InputConfig("C+L+R", (32, 48), lidar_sweeps=3), NET, NO_AUGMENTATION)


def made_run(folder: Path, row: RowConfig = ROW) -> Path:
    """The folder of a run of `row`, whose network has weights drawn by a seed."""
    write_run_row(folder, row)
    torch.manual_seed(0)
    assert isinstance(row.model, ColumnNetConfig)
    model = ColumnNet(row.model)
    nn.init.normal_(model.net.classify.weight)
    nn.init.zeros_(model.net.classify.bias)  # type: ignore[arg-type] # it has one
    nn.init.normal_(model.net.warm.weight, std=0.1)
    write_weights(folder, model, WeightsProvenance(row.as_json(), "0" * 64, "observed", 8, Position(step=7)))
    return folder
