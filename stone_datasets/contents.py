"""What a dataset holds, counted while its files are checked."""

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stone_datasets.index import DatasetIndex, DatasetSequence
from stone_datasets.labels import FrameLabels

CLASS_NAMES = ("free", "T", "P", "N")
NS_PER_S = 1e9


@dataclass
class DatasetContents:
    """Counts of files by channel, of voxels by class, of bytes."""

    index: DatasetIndex
    class_map: str
    files_of: Counter[str] = field(default_factory=Counter)
    voxels: Counter[str] = field(default_factory=Counter)
    masks: Counter[str] = field(default_factory=Counter)
    labelled: int = 0
    size_bytes: int = 0

    def add_labels(self, labels: FrameLabels) -> None:
        occupied = [int(np.count_nonzero(labels.classes == number)) for number in (1, 2, 3)]
        counts = dict(zip(CLASS_NAMES, (labels.classes.size - sum(occupied), *occupied), strict=True))
        self.voxels.update(counts)
        self.labelled += 1
        for name, mask in (("mask_lidar", labels.mask_lidar), ("mask_camera", labels.mask_camera)):
            if mask is not None:
                self.masks[name] += 1
                self.voxels[name] += int(np.count_nonzero(mask))

    def as_record(self) -> dict[str, Any]:
        """As `--json` prints it. Shares are of the occupied voxels; null where there are none."""
        occupied = sum(self.voxels[name] for name in CLASS_NAMES[1:])
        index = self.index
        return {
            "layout": index.layout,
            "version": index.files.version,
            "sequences": [_sequence_record(one) for one in index.sequences],
            "frames": sum(map(len, index.sequences)),
            "labelled_frames": self.labelled,
            "masks": {name: self.masks[name] for name in ("mask_lidar", "mask_camera")},
            "classes": self.class_map,
            "class_share_of_occupied": {
                name: self.voxels[name] / occupied if occupied else None for name in CLASS_NAMES[1:]
            },
            "voxels": {name: self.voxels[name] for name in CLASS_NAMES},
            "sensors": {name: self.files_of[name] for name in sorted(self.files_of)},
            "splits": {name: list(scenes) for name, scenes in index.splits.items()},
            "size_bytes": self.size_bytes,
        }


def _sequence_record(sequence: DatasetSequence) -> dict[str, Any]:
    seconds = float(sequence.stamps_ns[-1] - sequence.stamps_ns[0]) / NS_PER_S if len(sequence) else 0.0
    return {
        "name": sequence.name,
        "frames": len(sequence),
        "seconds": seconds,
        "is_labelled": sequence.is_labelled,
        "sensors": sorted(sequence.channels),
        "splits": list(sequence.splits),
    }
