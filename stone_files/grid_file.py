"""Files that describe a label grid: `grid.json` of a label set, and what `--grid` names.

**Conventions.** JSON, as `LabelGrid.as_record` makes it.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from stone_base.errors import Refused
from stone_base.label_grid import GRIDS, PAPER, LabelGrid, grid_of, named_grid

GRID_FILE = "grid.json"
MOST_BYTES = 64 * 1024


def chosen_grid(text: str) -> LabelGrid:
    """Return the grid of this name, or the one that the file at this path describes. Raises `bad_grid`."""
    return named_grid(text) if text in GRIDS or not Path(text).is_file() else read_grid_file(Path(text))


def chosen_grids(texts: Sequence[str]) -> tuple[LabelGrid, ...]:
    """Return the grids that these name, the paper's if none. Raises `bad_grid`, also for two of one name."""
    grids = tuple(map(chosen_grid, texts)) or (PAPER,)
    names = [grid.name for grid in grids]
    if len(set(names)) < len(names):
        raise Refused("bad_grid", f"two of the grids {', '.join(names)} have the same name; give each its own")
    return grids


def read_grid_file(path: Path) -> LabelGrid:
    """Return the grid that a file describes. Raises `bad_grid`."""
    try:
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
        if len(content) > MOST_BYTES:
            raise Refused("bad_grid", f"{path} has more than {MOST_BYTES} bytes; a grid is a name and a few numbers")
        return grid_of(json.loads(content))
    except (OSError, ValueError, RecursionError) as error:
        raise Refused("bad_grid", f"{path} is not JSON that describes a grid ({error})"[:300]) from error


def grid_text(grid: LabelGrid) -> str:
    """Return the file of a grid."""
    return json.dumps(grid.as_record(), indent=1) + "\n"
