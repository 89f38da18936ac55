"""ColumnNet as a program of static shapes for export: all learned layers, without geometry.

    points → maps, base (`ColumnNet.geometry`)      calibration → cells (`column_cells`)
    maps, base, images, cells → logits, log_temperature

**Conventions.** One frame at a time. `cells` (N, 2, X, Y) int64 are the cells of camera n's features at the two
surfaces of each column, row · width + column, −1 for invisible surfaces.
"""

import torch
from torch import Tensor, nn

from baselines.batch import Batch
from baselines.layers.camera_projection import pixels_from_grid, seen_cells
from baselines.layers.column_cameras import LightImageEncoder
from baselines.models.column_net import ColumnNet


class ColumnNetProgram(nn.Module):
    """The robot's program after points are sorted into columns."""

    def __init__(self, model: ColumnNet) -> None:
        super().__init__()
        self.encoder: LightImageEncoder | None = None if model.cameras is None else model.cameras.encoder
        self.net = model.net

    def forward(
        self, maps: Tensor, base: Tensor, images: Tensor | None = None, cells: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return logits (1, 4, X, Y, Z) and log temperatures (1, 1, X, Y, Z) of `maps` (1, C, X, Y), `base` (1, X,
        Y).
        """
        if self.encoder is not None and images is not None and cells is not None:
            maps = torch.cat([maps, looked_up(self.encoder(images), cells)], dim=1)
        logits, log_temperature = self.net(maps, base)
        return logits, log_temperature


def looked_up(features: Tensor, cells: Tensor) -> Tensor:
    """Return features (N, C, h, w) at `cells` (N, A, X, Y) as maps (1, A · C, X, Y): the mean over the cameras that
    see.
    """
    rows, index = features.flatten(2).transpose(1, 2), cells.flatten(1)
    is_seen = (index >= 0).to(rows.dtype)
    seen = [own[at.clamp(min=0)] * weight[:, None] for own, at, weight in zip(rows, index, is_seen, strict=True)]
    means = torch.stack(seen).sum(dim=0) / is_seen.sum(dim=0)[:, None].clamp(min=1)
    return means.reshape(*cells.shape[1:], -1).movedim(-1, 1).flatten(0, 1)[None]


def column_cells(model: ColumnNet, batch: Batch, surface_m: Tensor) -> Tensor:
    """Return `cells` of a batch of one frame. Raises `ValueError` if the model or the batch has no cameras."""
    if model.cameras is None or batch.cameras is None:
        raise ValueError("cells require cameras, but there are none")
    images = batch.cameras.images
    ground = model.lattice.centres_m(surface_m.device)[:, :, 0, :2].expand(*surface_m.shape[1:], 2)
    points = torch.cat([ground, surface_m[0, ..., None]], dim=-1).flatten(0, 2)
    shape = images.shape[-2], images.shape[-1]
    cells = points.new_full((images.shape[1], len(points)), -1, dtype=torch.int64)
    for own, matrix in zip(cells, pixels_from_grid(batch.cameras, batch.grid_from_camera())[0].float(), strict=True):
        seen, cell = seen_cells(points, matrix, shape, model.cameras.encoder.cells_of(shape))
        own[seen] = cell
    return cells.reshape(-1, *surface_m.shape[1:])


def program_inputs(model: ColumnNet, cameras: int, image: tuple[int, int]) -> dict[str, Tensor]:
    """Return zero inputs of the program by name, for `cameras` cameras with images of (height, width)."""
    x, y, _ = model.lattice.shape
    maps, base = torch.zeros(1, model.geometry_channels(), x, y), torch.zeros(1, x, y, dtype=torch.int64)
    inputs = {"maps": maps, "base": base}
    if model.cameras is not None:
        inputs["images"] = torch.zeros(cameras, 3, *image)
        inputs["cells"] = torch.zeros(cameras, 2, x, y, dtype=torch.int64)
    return inputs


def inputs_of(model: ColumnNet, batch: Batch) -> dict[str, Tensor]:
    """Return the inputs of a batch of one frame by name."""
    geometry = model.geometry(batch)
    inputs = {"maps": geometry.maps, "base": geometry.base}
    if model.cameras is not None and batch.cameras is not None:
        inputs["images"] = batch.cameras.images[0]
        inputs["cells"] = column_cells(model, batch, geometry.surface_m)
    return inputs
