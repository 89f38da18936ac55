"""Label grids over the wire: the grid of labels, and the choice of one."""

from typing import Annotated, Literal, Self

from pydantic import Field

from api.schemas.base import Answer, Body, example
from stone_base.label_grid import MOST_AWAY_M, PAPER, LabelGrid, grid_of, named_grid, recorded_grid

GridName = Literal["paper", "release", "occ3d"]
Metres = Annotated[float, Field(ge=-MOST_AWAY_M, le=MOST_AWAY_M, allow_inf_nan=False)]


class GridItem(Answer):
    """A grid in the ego frame: voxels of `voxel_m` from the corner `min_m` on, x, y, z."""

    model_config = example(name="paper", shape=[256, 256, 32], min_m=[-25.6, -25.6, -2.0], voxel_m=0.2)

    name: str
    shape: list[int]
    min_m: list[float]
    voxel_m: float

    @classmethod
    def recorded(cls, record: object) -> Self:
        """Return the grid that a row records, None being the paper's."""
        grid = recorded_grid(record)
        return cls(name=grid.name, shape=list(grid.shape), min_m=list(grid.min_m), voxel_m=grid.voxel_m)


class GridBody(Body):
    """A custom grid, as a file of `--grid` describes it.

    `unknown` is the number of unobserved voxels in exports, null if masks contain this information.
    """

    model_config = example(name="ahead", min_m=[0.0, -25.6, -2.0], voxel_m=0.2, shape=[256, 256, 32], unknown=None)

    name: Annotated[str, Field(max_length=40)]
    min_m: tuple[Metres, Metres, Metres]
    voxel_m: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
    shape: tuple[int, int, int]
    classes: tuple[int, int, int, int] = PAPER.classes
    unknown: int | None = None


def chosen_grid(choice: str | GridBody) -> LabelGrid:
    """Return the grid of this name, or that of the body. Raises `bad_grid`."""
    return named_grid(choice) if isinstance(choice, str) else grid_of(choice.model_dump())
