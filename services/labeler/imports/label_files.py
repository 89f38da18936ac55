"""The labels of a scene's frames: each read and checked, counted, put into packs, and shown to who makes the map.

**Conventions.** Bytes are the dataset's where they are labels of this platform already; else they are written as the
labeler writes its own. A mask that the dataset has not is 1 everywhere: nothing says of a voxel that it was not seen.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

import numpy as np

from services.labeler.frames import GRIDS, FrameVoxelCounts
from services.labeler.imports.label_counts import class_counts, set_count
from services.labeler.imports.scene_parts import SceneParts
from services.labeler.run_answers import PackAnswer, Range
from stone.labels.grid import GRID_SHAPE, Grid
from stone_datasets.classes import OWN_CLASSES, ClassMap
from stone_datasets.index import label_folder
from stone_datasets.labels import FrameLabels, read_labels
from stone_exports.files import ExportFileSpan
from stone_files.npz import npz_bytes

LABELS, PACKS = "labels", "packs"
FRAMES_A_PACK = 4096


@dataclass(eq=False)
class ImportedLabels:
    """What was written, frame after frame: ranges of packs, voxels by class (n, 4), observed (n, 2), and how many
    files were written anew, or had not which mask (`notes`)."""

    ranges: list[Range] = field(default_factory=list)
    classes: list[list[int]] = field(default_factory=list)
    observed: list[list[int]] = field(default_factory=list)
    notes: Counter[str] = field(default_factory=Counter)

    def counts(self) -> FrameVoxelCounts:
        return FrameVoxelCounts(np.array(self.classes, np.int64), np.array(self.observed, np.int64))

    def packs(self) -> list[PackAnswer]:
        """Named by their first frames."""
        firsts = range(0, len(self.ranges), FRAMES_A_PACK)
        return [
            PackAnswer(name=f"{PACKS}/{first:06d}.pack", first=first, ranges=self.ranges[first : first + FRAMES_A_PACK])
            for first in firsts
        ]


def copied_labels(parts: SceneParts, classes: ClassMap, out: Path, into: ImportedLabels) -> Iterator[Grid]:
    """The classes of each frame, once its labels are in the packs of the folder `out`.

    Raises a `DatasetFaultError`.
    """
    (out / LABELS).mkdir(parents=True)
    classes = OWN_CLASSES if np.array_equal(classes.meaning, OWN_CLASSES.meaning) else classes
    tokens, folder = parts.sequence.frames.tokens, label_folder(parts.sequence.name)
    for frame, (offset, size) in enumerate(parts.spans.labels.tolist()):
        labels = read_labels(ExportFileSpan(parts.tar, f"{folder}/{tokens[frame]}/labels.npz", offset, size), classes)
        path = out / LABELS / f"{frame // FRAMES_A_PACK * FRAMES_A_PACK:06d}.pack"
        _add(labels, path, into)
        yield labels.classes


def _add(labels: FrameLabels, path: Path, into: ImportedLabels) -> None:
    masks = {"mask_lidar": labels.mask_lidar, "mask_camera": labels.mask_camera}
    grids = [np.ones(GRID_SHAPE, np.uint8) if mask is None else mask for mask in masks.values()]
    payload = labels.content
    if payload is None:
        payload = npz_bytes(dict(zip(GRIDS, (labels.classes, *grids), strict=True)))
        into.notes["rewritten"] += 1
    into.notes.update(name for name, mask in masks.items() if mask is None)
    with path.open("ab") as pack:
        into.ranges.append((pack.tell(), len(payload), sha256(payload).hexdigest()))
        pack.write(payload)
    into.classes.append(class_counts(labels.classes))
    into.observed.append([set_count(grid) for grid in grids])
