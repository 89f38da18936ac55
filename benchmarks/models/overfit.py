"""Every row, scaled down, overfits one simulated frame: `python -m benchmarks.models.overfit [--rows ROW ...]`.

A row that fails has a fault between its inputs and its losses. The frame is the middle frame of simulated world 1, with
all sensors as simulated. It has 32 × 32 × 16 or 48 × 48 × 16 voxels around the robot, images of 96 × 160 and no
augmentation. Unobserved voxels are not counted. mIoU over T, P and N is of the network in evaluation. The learning rate
falls by a cosine. One thread; a row ends at its last step, at `--enough`, or after `--most` CPU-seconds.
"""

import argparse
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from rich.console import Console
from rich.table import Table

from baselines.batch import Batch
from baselines.cache import CachedStore, cached_frames
from baselines.data import FrameDataset, FrameRequest
from baselines.lattice import VoxelLattice
from baselines.metrics import BatchLosses, RateSchedule, build_optimizer, confusion_of, scores_of, take_step
from baselines.models.architectures import ModelConfig, build_model
from baselines.models.occupancy_model import OccupancyModel
from baselines.row_config import RowConfig, TrainingConfig, read_row
from baselines.sources import labelled_frames
from benchmarks.models.unseen import EVERY, SECONDS
from benchmarks.models.worlds import made_world

PART = VoxelLattice((-4.8, -4.8, -1.2), (0.2, 0.2, 0.2), (48, 48, 16))
SMALLER_PART = VoxelLattice((-3.2, -3.2, -1.2), (0.2, 0.2, 0.2), (32, 32, 16))
PICTURES_PX = (96, 160)
LOOK_EVERY = 20
STEPS = {  # steps within four CPU-minutes
    "c-conet": 1200, "c-openocc": 1400, "column-net": 280, "l-conet": 800, "l-openocc": 800, "m-conet": 700,
    "m-openocc": 700, "occformer": 700, "occfusion-cl": 360, "occfusion-cr": 400, "tpvformer": 700,
}  # fmt: skip
TRAINING = TrainingConfig(learning_rate=3e-3, weight_decay=0.0, warmup_steps=10, clip_norm=10.0, precision="float32")
BACKBONE = {"backbone_depth": 14, "backbone_width": 16, "backbone_deformable_stages": (False,) * 4}
SCALED_DOWN: Mapping[str, Mapping[str, Any]] = {
    "openocc": {
        "lattice": SMALLER_PART, "volume_channels": 16, "sparse_channels": 8, "residual_channels": (32, 48, 64, 96),
        "residual_blocks": (1, 1, 1, 1), "pyramid_channels": 48, "fine_channels": 32, "resnet_depth": 14,
        "resnet_width": 16, "neck_channels": (8, 8, 8, 8), "image_shape": PICTURES_PX, "depth_dropout": 0.0,
        "depth_range_m": (0.5, 12.5),
    },
    "tpvformer": {
        **BACKBONE, "channels": 48, "heads": 4, "layers": 2, "feedforward_channels": 96, "hidden_channels": 96,
        "dropout": 0.0, "anchors": (4, 8, 8),
    },
    "occformer": {
        **BACKBONE, "neck_channels": 16, "depth_range_m": (0.5, 12.5), "depth_dropout": 0.0, "drop_path": 0.0,
        "context_dropout": 0.0, "stage_channels": (32, 32, 64, 64), "stage_blocks": (1, 1, 1, 1), "head_channels": 16,
        "decoder_channels": 48, "pixel_layers": 2, "pixel_heads": 4, "queries": 16, "query_layers": 3,
        "query_heads": 4, "mask_points": 4096,
    },
    "occfusion": {
        "resnet_depth": 14, "resnet_width": 16, "deformable_stages": (False,) * 4, "pyramid_channels": 32,
        "level_channels": (24, 24, 32, 48), "point_widths": (8, 8), "head_channels": 8,
    },
    "column_net": {"widths": (24, 32, 48, 64), "depths": (1, 1, 1, 1)},
}  # fmt: skip


@dataclass(frozen=True)
class OverfitLook:
    """A row's state after some steps. `cpu_s` is of training alone."""

    step: int
    cpu_s: float
    miou: float


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--folder", type=Path, default=Path("build/models"))
    arguments.add_argument("--rows", nargs="+", choices=list(STEPS), default=list(STEPS))
    arguments.add_argument("--most", type=float, default=240.0, help="maximum CPU-seconds of a row")
    arguments.add_argument("--enough", type=float, default=0.95, help="mIoU at which a row ends")
    options = arguments.parse_args()
    torch.set_num_threads(1)
    world, console = made_world(options.folder, 1, SECONDS, EVERY), Console(width=140)
    table = Table("row", "voxels", "parameters", "mIoU % (step, CPU-s)", title="one frame of world 1")
    for name in options.rows:
        row = scaled_down(read_row(name))
        torch.manual_seed(0)
        model = build_model(row.model)
        size = f"{sum(parameter.numel() for parameter in model.parameters()):,}"
        cells = []
        for look in overfit(model, one_frame(row, world.export, options.folder / "overfit"), STEPS[name]):
            cells.append(f"{100 * look.miou:.1f} ({look.step}, {look.cpu_s:.0f})")
            if look.miou >= options.enough or look.cpu_s >= options.most:
                break
        table.add_row(name, " × ".join(map(str, row.model.lattice.shape)), size, "  ".join(cells))
        console.print(f"{name}: {size} parameters, {cells[-1]}")
    console.print(table)


def scaled_down(row: RowConfig) -> RowConfig:
    """Return the row on a part of the grid, a tenth as wide, with small images and five sweeps.

    M rows have one, since their steps cost twice as much; OpenOccupancy's rows use less than half of the part, for many
    steps. OccFusion's finest level stays 24 wide: its heads have no norms, and of eight hidden units most die.
    """
    model: ModelConfig = replace(row.model, **{"lattice": PART, **SCALED_DOWN[row.model.architecture]})
    sweeps = 1 if row.name.startswith("m-") else 5
    return replace(row, model=model, inputs=replace(row.inputs, image_size_px=PICTURES_PX, lidar_sweeps=sweeps))


def one_frame(row: RowConfig, export: Path, cache: Path) -> Batch:
    """Return the world's middle frame."""
    frames = cached_frames(labelled_frames([export]), row.inputs, cache, lambda *_: None)
    dataset = FrameDataset(CachedStore(frames), FrameRequest(row.inputs, row.model.lattice, counted="observed"))
    return dataset[0, len(frames) // 2]


def overfit(model: OccupancyModel[Any], batch: Batch, steps: int) -> Iterator[OverfitLook]:
    """Train on the one frame, and yield its state now and then."""
    optimizer, schedule = build_optimizer(model, TRAINING), RateSchedule(TRAINING, steps)
    parameters, losses, cpu_s = list(model.parameters()), BatchLosses(model, TRAINING.precision), 0.0
    for begin in range(0, steps, LOOK_EVERY):
        begun = time.process_time()
        for step in range(begin, begin + LOOK_EVERY):
            terms, _ = losses(batch)
            torch.autograd.backward(sum(terms.values(), batch.grid_from_ego.new_zeros(())))
            take_step(parameters, optimizer, TRAINING.learning_rate * schedule.ratio(step), TRAINING.clip_norm)
        cpu_s += time.process_time() - begun
        yield OverfitLook(begin + LOOK_EVERY, cpu_s, miou_of(model, batch))


def miou_of(model: OccupancyModel[Any], batch: Batch) -> float:
    """Return mIoU over T, P and N of the network in evaluation."""
    if batch.labels is None:
        raise ValueError("the frame has no labels")
    model.eval()
    with torch.inference_mode():
        confusion = confusion_of(model.logits(model(batch), batch), batch.labels)
    model.train()
    return scores_of(confusion)["miou"] or 0.0


if __name__ == "__main__":
    main()
