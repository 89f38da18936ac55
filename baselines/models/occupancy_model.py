"""What every row answers: outputs of a batch, losses of outputs, and logits of the four classes on its lattice.

**Conventions.** `forward` is all that is differentiated and run under autocast; geometry (lifting, projecting, voxel
indices) and losses leave autocast and compute in float32 (`torch.autocast(..., enabled=False)`).
"""

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

from torch import Tensor, nn

from baselines.batch import Batch
from baselines.lattice import VoxelLattice
from stone.scoring import metric

Outputs = TypeVar("Outputs")
CLASSES = metric.CLASSES  # free, T, P, N


class OccupancyModel(nn.Module, ABC, Generic[Outputs]):
    """A network from a batch to classes of voxels."""

    lattice: VoxelLattice
    modality: str  # of "C", "L", "R", joined by "+", as a benchmark's tracks are written

    @abstractmethod
    def forward(self, batch: Batch) -> Outputs:
        """Everything that losses and logits need; in training mode also what only losses need."""

    @abstractmethod
    def losses(self, outputs: Outputs, batch: Batch) -> dict[str, Tensor]:
        """Terms by name, each a weighted scalar float32; what is minimised is their sum. Needs `batch.labels`."""

    @abstractmethod
    def logits(self, outputs: Outputs, batch: Batch) -> Tensor:
        """(B, 4, X, Y, Z) float32 on `self.lattice` in the grid frame; their argmax is the prediction."""
