"""The interface of every row: outputs of a batch, losses of outputs, and logits of the four classes on its lattice.

**Conventions.** Only `forward` is differentiated and run under autocast; geometry (lifting, projecting, voxel indices)
and losses leave autocast and compute in float32 (`torch.autocast(..., enabled=False)`).
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import torch
from torch import Tensor, nn

from baselines.batch import Batch
from baselines.lattice import VoxelLattice
from stone.scoring import metric

Outputs = TypeVar("Outputs")
CLASSES = metric.CLASSES  # free, T, P, N


class OccupancyModel(nn.Module, ABC, Generic[Outputs]):
    """A network from a batch to classes of voxels."""

    lattice: VoxelLattice
    modality: str  # of "C", "L", "R", joined by "+", as in a benchmark's tracks

    @abstractmethod
    def forward(self, batch: Batch) -> Outputs:
        """Return the inputs of losses and logits; in training mode also the inputs of losses only."""

    @abstractmethod
    def losses(self, outputs: Outputs, batch: Batch) -> dict[str, Tensor]:
        """Return weighted float32 scalars by name; training minimises their sum. Requires `batch.labels`."""

    @abstractmethod
    def logits(self, outputs: Outputs, batch: Batch) -> Tensor:
        """Return (B, 4, X, Y, Z) float32 on `self.lattice` in the grid frame; their argmax is the prediction."""

    def classes(self, outputs: Outputs, batch: Batch) -> Tensor:
        """Return the prediction, (B, X, Y, Z) uint8."""
        return likeliest(self.logits(outputs, batch))


def likeliest(logits: Tensor) -> Tensor:
    """Return classes (B, ...) uint8 of the largest of logits (B, C, ...), the first of equal ones.

    Without NaN it equals `argmax` over dimension 1, in a tenth of its time on a CPU.
    """
    most = logits[:, 0]
    classes = torch.zeros_like(most, dtype=torch.uint8)
    for number in range(1, logits.shape[1]):
        classes = torch.where(logits[:, number] > most, number, classes)
        most = torch.maximum(most, logits[:, number])
    return classes
