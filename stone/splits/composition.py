"""The composition of a dataset: its catalogue of sequences, and sums over them by their attributes.

**Conventions.** Voxels are (T, P, N) of all frames, None where they are not known or not to be told; they add only
where they are known, so shares of classes are of those sequences. Regions are compared without regard to
case, blanks, dashes and underscores (`Lake 1`, `lake-1` and `Lake_1` are one) and shown as one of them is spelled.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.splits.drives import DrivenTrack
from stone.splits.surroundings import DAYLIGHT, ENVIRONMENTS, HALVES, ILLUMINATIONS, UNSAID
from stone_base.label_quality import UNKNOWN, LabelQuality, pooled

Voxels = tuple[int, int, int]


def path_length_m(positions_map: NDArray[np.float64]) -> float:
    """How far the robot went: the length of the line through its positions (N, 3); 0 for fewer than two."""
    steps = np.diff(np.asarray(positions_map, np.float64).reshape(-1, 3), axis=0)
    return float(np.sqrt((steps**2).sum(axis=1)).sum())


def duration_ns(stamps_ns: NDArray[np.int64]) -> int:
    """How long a sequence lasts: from its first stamp to its last (rising, (N,)), and one mean period, as each frame
    stands for the time until the next; 0 for fewer than two.
    """
    if len(stamps_ns) < 2:
        return 0
    span = int(stamps_ns[-1]) - int(stamps_ns[0])
    return span * len(stamps_ns) // (len(stamps_ns) - 1)


@dataclass(frozen=True)
class CatalogueEntry:
    """A labelled sequence as the dataset sees it; two that share a recording (its sha256) are one sequence twice.

    `voxels` is None, and `distance_m` is, where the labels were made before these were kept. `exposure` says why
    anybody may have its labels, '' where nobody may. `drive` names the drive of which the sequence is one of several,
    '' if it is a drive by itself, and `drive_s` is how long those last together; `track` is None if it is unknown.
    """

    id: str
    name: str
    environment: str
    illumination: str
    region: str
    duration_s: float
    frames: int
    voxels: Voxels | None = None
    distance_m: float | None = None
    recordings: tuple[str, ...] = ()
    exposure: str = ""
    quality: LabelQuality = UNKNOWN
    drive: str = ""
    drive_s: float = 0.0
    track: DrivenTrack | None = None

    @property
    def half(self) -> str:
        """day, night, or '' where it is not said."""
        return DAYLIGHT.get(self.illumination, UNSAID)

    @property
    def region_key(self) -> str:
        return re.sub(r"[\s_-]+", "", self.region.casefold())

    @property
    def drive_key(self) -> tuple[str, str]:
        """Equal for the sequences of one drive."""
        return (self.drive, "") if self.drive else ("", self.id)


@dataclass(frozen=True)
class CompositionSums:
    """Sums over some sequences, which are so many `drives`.

    `counted` of them have voxels, `measured` a distance, `judged` a held-out track. `quality` is the recall of all
    judged metres together, and the gravest finding of any.
    """

    sequences: int = 0
    drives: int = 0
    frames: int = 0
    duration_s: float = 0.0
    distance_m: float = 0.0
    measured: int = 0
    voxels: Voxels = (0, 0, 0)
    counted: int = 0
    judged: int = 0
    quality: LabelQuality = UNKNOWN

    def class_shares(self) -> tuple[float, float, float] | None:
        """T, P and N of the occupied voxels; None where there are none."""
        total = sum(self.voxels)
        return (self.voxels[0] / total, self.voxels[1] / total, self.voxels[2] / total) if total else None


def sums_of(entries: Iterable[CatalogueEntry]) -> CompositionSums:
    """The sums; exact for what is counted, and for seconds and metres the same whatever the order."""
    rows = sorted(entries, key=lambda entry: entry.id)
    voxels = [entry.voxels for entry in rows if entry.voxels is not None]
    distances = [entry.distance_m for entry in rows if entry.distance_m is not None]
    return CompositionSums(
        sequences=len(rows),
        drives=len({entry.drive_key for entry in rows}),
        frames=sum(entry.frames for entry in rows),
        duration_s=sum(entry.duration_s for entry in rows),
        distance_m=sum(distances),
        measured=len(distances),
        voxels=(sum(t for t, _, _ in voxels), sum(p for _, p, _ in voxels), sum(n for _, _, n in voxels)),
        counted=len(voxels),
        judged=sum(entry.quality.held_out_recall is not None for entry in rows),
        quality=pooled(entry.quality for entry in rows),
    )


@dataclass(frozen=True)
class Composition:
    """The dataset by each way of looking at it; keys that no sequence has are left out, '' is what was not said."""

    total: CompositionSums
    environments: Mapping[str, CompositionSums]
    illuminations: Mapping[str, CompositionSums]
    halves: Mapping[str, CompositionSums]
    regions: Mapping[str, CompositionSums]
    cells: Mapping[tuple[str, str], CompositionSums]
    """By (environment, illumination)."""


def composition_of(entries: Iterable[CatalogueEntry]) -> Composition:
    """The dataset by environment, illumination, day or night, region, and environment × illumination."""
    rows = tuple(entries)
    return Composition(
        total=sums_of(rows),
        environments=_by({entry.id: entry.environment for entry in rows}, rows, ENVIRONMENTS),
        illuminations=_by({entry.id: entry.illumination for entry in rows}, rows, ILLUMINATIONS),
        halves=_by({entry.id: entry.half for entry in rows}, rows, HALVES),
        regions=_by(region_names(rows), rows, ()),
        cells=_cells(rows),
    )


def region_names(entries: Iterable[CatalogueEntry]) -> dict[str, str]:
    """Return the region of each sequence by its id, in the first spelling (by the alphabet) that the region has."""
    rows = sorted(entries, key=lambda entry: entry.region, reverse=True)
    spelled = {entry.region_key: entry.region for entry in rows}
    return {entry.id: spelled[entry.region_key] for entry in rows}


def _by(
    key_of: Mapping[str, str], rows: tuple[CatalogueEntry, ...], order: tuple[str, ...]
) -> dict[str, CompositionSums]:
    """In the order of the words; then what is no word of ours by name; what was not said last."""
    keys = set(key_of.values())
    others = sorted(keys - {*order, UNSAID})
    ordered = [key for key in (*order, *others, UNSAID) if key in keys]
    return {key: sums_of(entry for entry in rows if key_of[entry.id] == key) for key in ordered}


def _cells(rows: tuple[CatalogueEntry, ...]) -> dict[tuple[str, str], CompositionSums]:
    keys = sorted({(entry.environment, entry.illumination) for entry in rows})
    return {key: sums_of(entry for entry in rows if (entry.environment, entry.illumination) == key) for key in keys}
