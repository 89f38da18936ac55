"""Submissions as files, from grids."""

from collections.abc import Iterable
from pathlib import Path

from stone_base.label_grid import PAPER, LabelGrid
from stone_submissions.archive import Grid, frame_file, write_files


def write_submission(path: Path, frames: Iterable[tuple[str, Grid]], label_grid: LabelGrid = PAPER) -> None:
    """Write frames (token, grid) as a submission; the same frames give the same bytes."""
    write_files(path, ((token, frame_file(grid, label_grid)) for token, grid in frames))
