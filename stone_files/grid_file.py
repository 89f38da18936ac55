"""Files that describe a label grid: `grid.json` of a label set, and the argument of `--grid`.

**Conventions.** JSON in the form of `LabelGrid.as_record`.
"""

import json
from collections.abc import Sequence
from pathlib import Path

from stone_base.errors import Refused
from stone_base.label_grid import GRIDS, PAPER, LabelGrid, grid_of, named_grid

GRID_FILE = "grid.json"
MOST_BYTES = 64 * 1024


def chosen_grid(text: str) -> LabelGrid:
    """Return the grid with this name, or the grid in the file at this path. Raises `bad_grid`."""
    return named_grid(text) if text in GRIDS or not Path(text).is_file() else read_grid_file(Path(text))


def chosen_grids(texts: Sequence[str]) -> tuple[LabelGrid, ...]:
    """Return the grids with these names or paths, or the paper's if there are none. Raises `bad_grid`, also for equal
    names.
    """
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
    """Return the content of a grid file."""
    return json.dumps(grid.as_record(), indent=1) + "\n"
