"""Submissions as files, from grids."""

from collections.abc import Iterable
from pathlib import Path

from stone_submissions.archive import Grid, frame_file, write_files


def write_submission(path: Path, frames: Iterable[tuple[str, Grid]]) -> None:
    """Frames (token, grid) as a submission; the same frames give the same bytes."""
    write_files(path, ((token, frame_file(grid)) for token, grid in frames))
