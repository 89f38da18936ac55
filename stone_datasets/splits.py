"""Splits of a dataset: `splits.json` next to the tables or in the root, or the splits in annotations.json.

**Conventions.** As the devkit's custom splits: {split: [scene, …]}. Our exports, and others, have a split "all" with
every scene; a scene may be in it and in one other split.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from stone_datasets.columns import repeated
from stone_datasets.faults import DatasetFaults, DatasetPlace, quoted
from stone_datasets.files import DatasetFiles
from stone_datasets.json_stream import JsonStream
from stone_files.dataset_faults import DatasetFaultError

SPLITS, ALL = "splits.json", "all"
MOST_SPLITS = 1000
Splits = Mapping[str, tuple[str, ...]]


def read_splits(files: DatasetFiles) -> tuple[str, Splits]:
    """Return the file of the splits and its content, or no splits if there is none. Raises a `DatasetFaultError`."""
    names = [name for name in (SPLITS, f"{files.version}/{SPLITS}") if files.span(name) is not None]
    if len(names) > 1:
        raise DatasetFaultError("DST-045", DatasetPlace(names[0]), f"{names[1]} also exists")
    span = files.span(names[0]) if names else None
    if span is None:
        return SPLITS, {}
    stream = JsonStream(span)
    if stream.peek() != "{":
        raise DatasetFaultError("DST-045", DatasetPlace(span.name), f"it starts with {quoted(stream.peek())}")
    splits: dict[str, tuple[str, ...]] = {}
    for key in stream.items():
        if key in splits or len(splits) >= MOST_SPLITS:
            raise DatasetFaultError(
                "DST-045", DatasetPlace(span.name), f"{quoted(key)} is listed twice, or there are too many splits"
            )
        splits[key] = scenes_named(span.name, key, stream.value())
    stream.end()
    return span.name, splits


def scenes_named(file: str, split: str, names: Any) -> tuple[str, ...]:
    """Return the list of a split. Raises `DST-045`."""
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise DatasetFaultError("DST-045", DatasetPlace(file), f"{quoted(split)} is {quoted(names)}")
    return tuple(names)


def check_splits(read: tuple[str, Splits], scenes: Iterable[str], faults: DatasetFaults) -> None:
    """Check that every scene of a split exists and is in no other split."""
    (file, splits), known = read, set(scenes)
    named = [(split, name) for split, names in splits.items() for name in names]
    for split, name in named:
        if name not in known:
            faults.add(DatasetFaultError("DST-046", DatasetPlace(file), f"{quoted(split)} names {quoted(name)}"))
    parting = [(split, name) for split, name in named if split != ALL]
    for again, first in repeated([hash(name) for _, name in parting]):
        what = f"{quoted(parting[again][1])} is in both {quoted(parting[first][0])} and {quoted(parting[again][0])}"
        faults.add(DatasetFaultError("DST-047", DatasetPlace(file), what))


def splits_of(splits: Splits) -> Mapping[str, tuple[str, ...]]:
    """Return the splits of each scene by its name."""
    by_scene: dict[str, tuple[str, ...]] = {}
    for split, names in splits.items():
        for name in names:
            by_scene[name] = (*by_scene.get(name, ()), split)
    return by_scene
