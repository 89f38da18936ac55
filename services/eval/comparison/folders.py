"""Comparison of two local label folders, with frames matched by token."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from services.domain.viewer.frame_picture import comparison_picture
from services.eval.comparison.counting import FrameGrids, LabelGrids, counted_pairs, label_grids
from services.eval.comparison.record import ComparedFrames, comparison_record
from services.eval.comparison.stage import no_shared_frame
from stone_base.label_grid import LabelGrid, require_one_geometry
from stone_files.atomic import atomic_file
from stone_submissions.errors import GroundTruthError
from stone_submissions.ground_truth import MAX_LABELS_BYTES, find_ground_truth
from stone_submissions.manifest import read_bounded
from stone_submissions.validation import Progress, silent


@dataclass(frozen=True)
class LabelFolders:
    """The label files of A and B by frame token, for the frames in both in the order of A, and their grid."""

    a: dict[str, Path]
    b: dict[str, Path]
    frames: ComparedFrames
    grid: LabelGrid

    def grids(self, token: str) -> tuple[LabelGrids, LabelGrids]:
        """Return the labels of a frame in A and B. Raises `UnreadableInputError`, `GroundTruthError`."""
        return _read_labels(self.a[token], self.grid), _read_labels(self.b[token], self.grid)

    def pairs(self) -> Iterator[FrameGrids]:
        return (partial(self.grids, token) for token in self.frames.tokens)


def open_folders(a: Path, b: Path) -> LabelFolders:
    """Open two folders with `gts/<sequence>/<frame_token>/labels.npz`.

    Raises `UnreadableInputError`, `GroundTruthError`, `unknown_grid`, `grids_differ`, `nothing_in_common`.
    """
    truths = [find_ground_truth(folder) for folder in (a, b)]
    of_a, of_b = (truth.paths() for truth in truths)
    grid, other = (truth.manifest.grid for truth in truths)
    require_one_geometry(grid, other)
    shared = [token for token in of_a if token in of_b]
    if not shared:
        raise no_shared_frame(str(a), str(b), (len(of_a), len(of_b)))
    return LabelFolders(of_a, of_b, ComparedFrames(shared, len(of_a) - len(shared), len(of_b) - len(shared)), grid)


def compare_folders(folders: LabelFolders, progress: Progress = silent) -> dict[str, Any]:
    """Return the record of the comparison. Raises what `LabelFolders.grids` raises."""
    counts = counted_pairs(folders.pairs(), len(folders.frames.tokens), folders.grid, progress)
    return comparison_record(folders.frames, counts)


def write_pictures(folders: LabelFolders, record: dict[str, Any], folder: Path) -> list[Path]:
    """Write `<frame_token>.png` of the least similar frames: A, B and the difference from above.

    Raises as `LabelFolders.grids`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for frame in record["least_alike"]:
        a, b = folders.grids(frame["token"])
        path = folder / f"{frame['token']}.png"
        with atomic_file(path) as staging:
            staging.write_bytes(comparison_picture((a.semantics, a.seen), (b.semantics, b.seen)))
        written.append(path)
    return written


def _read_labels(path: Path, grid: LabelGrid) -> LabelGrids:
    return label_grids(read_bounded(path, MAX_LABELS_BYTES, GroundTruthError), path, grid)
