"""The manifest of a dataset version: its contents in one JSON file whose sha256 identifies it.

**Conventions.** It lists the files of train and val. Of test it says which sequences there are and under which
conditions, and nothing that was learnt from their labels: no file, no digest, no count; `statistics` hold the voxels of
train and val only.
"""

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from services.domain.datasets.catalogue import CatalogueSequence, entries_of
from services.domain.datasets.exposure import HIDDEN
from services.domain.datasets.files import DatasetFile
from services.domain.datasets.statistics import CLASSES, statistics_record
from services.runtime.code_version import code_version
from stone.splits.composition import CatalogueEntry
from stone.splits.surroundings import DAYLIGHT, UNSAID

FORMAT = 1

Members = Mapping[str, tuple[CatalogueSequence, ...]]


@dataclass(frozen=True)
class NewDataset:
    """A dataset version to publish; `name` is the version's."""

    name: str
    licence: str
    user_id: str


def manifest_bytes(
    asked: NewDataset, created_ns: int, members: Members, files: Mapping[str, tuple[DatasetFile, ...]]
) -> bytes:
    """The manifest as a file; `files` are those of the parts that are open."""
    record = {
        "stone_dataset": FORMAT,
        "version": asked.name,
        "licence": asked.licence,
        "created_ns": created_ns,
        "code_version": code_version("labels"),
        "splits": {part: [one.sequence.name for one in labelled] for part, labelled in members.items()},
        "sequences": [_described(one, part) for part, labelled in members.items() for one in labelled],
        "statistics": told_statistics(members),
        "files": {part: [file.as_record() for file in of_part] for part, of_part in files.items()},
    }
    return (json.dumps(record, sort_keys=True, ensure_ascii=False, allow_nan=False) + "\n").encode()


def told_statistics(members: Members) -> dict[str, Any]:
    """Statistics of all parts, with the voxels of those that are open."""
    return statistics_record({part: open_entries(part, entries_of(labelled)) for part, labelled in members.items()})


def open_entries(part: str, entries: Iterable[CatalogueEntry]) -> tuple[CatalogueEntry, ...]:
    """The entries of a part as everybody may know them: of test without voxels."""
    return tuple(replace(entry, voxels=None) if part == HIDDEN else entry for entry in entries)


def _described(one: CatalogueSequence, part: str) -> dict[str, Any]:
    """The public record of a sequence; of an open one also the recipe of its labels and what they add up to."""
    entry = one.entry
    said = {
        "name": entry.name,
        "split": part,
        "environment": entry.environment,
        "illumination": entry.illumination,
        "daylight": DAYLIGHT.get(entry.illumination, UNSAID),
        "region": entry.region,
        "frames": entry.frames,
        "duration_s": entry.duration_s,
        "distance_m": entry.distance_m,
    }
    if part == HIDDEN:
        return said
    voxels = dict(zip(CLASSES, entry.voxels, strict=True)) if entry.voxels is not None else None
    return {**said, "label_set": {"id": one.labels.id, "recipe": one.labels.recipe}, "voxels": voxels}
