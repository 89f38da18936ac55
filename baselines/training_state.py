"""The changing state of a training: weights, the optimiser, and the position; new or from a checkpoint."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.nn.parallel import DistributedDataParallel

from baselines.cache import CachedFrame, data_hash
from baselines.checkpoint import WeightsProvenance, read_checkpoint, write_checkpoint
from baselines.metrics import BatchLosses, build_optimizer
from baselines.models.architectures import build_model, with_class_counts
from baselines.models.occupancy_model import OccupancyModel
from baselines.processes import ProcessShare
from baselines.row_config import RowConfig, row_of
from stone.errors import Refused
from stone.scoring.metric import METRIC_VERSION


@dataclass
class TrainingState:
    """`losses` is the model as the minimised function, over all processes."""

    model: OccupancyModel[Any]
    losses: nn.Module
    optimizer: torch.optim.Optimizer
    provenance: WeightsProvenance

    def parameters(self) -> list[nn.Parameter]:
        return [parameter for parameter in self.model.parameters() if parameter.requires_grad]

    def at(self, **position: int) -> None:
        """Set the position."""
        self.provenance = replace(self.provenance, position=replace(self.provenance.position, **position))

    def keep(self, folder: Path) -> None:
        """Write the checkpoint."""
        write_checkpoint(folder, self.model, self.optimizer, self.provenance)


def initial_state(row: RowConfig, frames: Sequence[CachedFrame], share: ProcessShare) -> TrainingState:
    """Return the state before the first step: weights by the row's seed, classes weighted by the voxels of `frames`."""
    torch.manual_seed(row.training.seed)
    free, t, p, n = (sum(frame.voxels[class_index] for frame in frames) for class_index in range(4))
    if row.training.counted == "all":
        unsure = sum(frame.unsure for frame in frames)
        free = sum(any(frame.voxels) for frame in frames) * row.label_grid.voxels - t - p - n - unsure
    model = build_model(with_class_counts(row.model, (free, t, p, n))).to(share.device)
    losses: nn.Module = BatchLosses(model, row.training.precision)
    if share.world > 1:
        losses = DistributedDataParallel(losses, find_unused_parameters=True)
    provenance = WeightsProvenance(row.as_json(), data_hash(frames), METRIC_VERSION, len(frames), share.world)
    torch.manual_seed(row.training.seed + 1 + share.rank)
    return TrainingState(model, losses, build_optimizer(model, row.training), provenance)


def resumed_state(folder: Path, state: TrainingState) -> TrainingState:
    """Return the state of the run's checkpoint. Raises `bad_run` if it has another row or other data."""
    read = read_checkpoint(folder, state.model, state.optimizer)
    same: Mapping[str, tuple[object, object]] = {
        "row": (row_of(str(folder), json.loads(read.config)).as_json(), state.provenance.config),
        "data": (read.data_sha256, state.provenance.data_sha256),
        "number of processes": (read.processes, state.provenance.processes),
    }
    for name, (then, now) in same.items():
        if then != now:
            raise Refused("bad_run", f"{folder}: its {name} has changed: {str(then)[:64]} then, {str(now)[:64]} now")
    return replace(state, provenance=read)
