"""The composition of a dataset: its catalogue of sequences, and sums over them by their attributes.

**Conventions.** Voxels are (T, P, N) of all frames, None if unknown or hidden; sums use known voxels only, so shares of
classes refer to these sequences. Regions are compared without case, spaces, dashes and underscores (`Lake 1`, `lake-1`
and `Lake_1` are equal) and shown in one of their spellings.
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
    """Return the length in metres of the line through positions (N, 3); 0 for fewer than two."""
    steps = np.diff(np.asarray(positions_map, np.float64).reshape(-1, 3), axis=0)
    return float(np.sqrt((steps**2).sum(axis=1)).sum())


def duration_ns(stamps_ns: NDArray[np.int64]) -> int:
    """Return a sequence's duration: from first to last stamp (increasing, (N,)) plus one mean period, because each
    frame represents the time until the next; 0 for fewer than two.
    """
    if len(stamps_ns) < 2:
        return 0
    span = int(stamps_ns[-1]) - int(stamps_ns[0])
    return span * len(stamps_ns) // (len(stamps_ns) - 1)


@dataclass(frozen=True)
class CatalogueEntry:
    """A labelled sequence in the catalogue; two sequences that share a recording (its sha256) are duplicates.

    `voxels` and `distance_m` are None for labels of earlier versions without these values. `exposure` is the reason why
    the labels may be known, '' if they are not. `drive` names the drive that the sequence shares with others, '' if it
    is its own drive, and `drive_s` is the drive's total duration. `track` is None if unknown.
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
        """Return day, night, or '' if unspecified."""
        return DAYLIGHT.get(self.illumination, UNSAID)

    @property
    def region_key(self) -> str:
        return re.sub(r"[\s_-]+", "", self.region.casefold())

    @property
    def drive_key(self) -> tuple[str, str]:
        """The key of the drive, equal for all its sequences."""
        return (self.drive, "") if self.drive else ("", self.id)


@dataclass(frozen=True)
class CompositionSums:
    """Sums over sequences that belong to `drives` drives.

    `counted` of them have voxels, `measured` a distance, `judged` a held-out track. `quality` is the recall over all
    judged metres, and the most harmful finding.
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
        """Return the shares of T, P and N among occupied voxels; None without occupied voxels."""
        total = sum(self.voxels)
        return (self.voxels[0] / total, self.voxels[1] / total, self.voxels[2] / total) if total else None


def sums_of(entries: Iterable[CatalogueEntry]) -> CompositionSums:
    """Return the sums: exact counts, and seconds and metres independent of the order."""
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
    """The dataset by each attribute; keys without a sequence are left out, '' is unspecified."""

    total: CompositionSums
    environments: Mapping[str, CompositionSums]
    illuminations: Mapping[str, CompositionSums]
    halves: Mapping[str, CompositionSums]
    regions: Mapping[str, CompositionSums]
    cells: Mapping[tuple[str, str], CompositionSums]
    """Sums by (environment, illumination)."""


def composition_of(entries: Iterable[CatalogueEntry]) -> Composition:
    """Return the dataset by environment, illumination, day or night, region, and environment × illumination."""
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
    """Return the region of each sequence by its id, in the region's alphabetically first spelling."""
    rows = sorted(entries, key=lambda entry: entry.region, reverse=True)
    spelled = {entry.region_key: entry.region for entry in rows}
    return {entry.id: spelled[entry.region_key] for entry in rows}


def _by(
    key_of: Mapping[str, str], rows: tuple[CatalogueEntry, ...], order: tuple[str, ...]
) -> dict[str, CompositionSums]:
    """Return the sums in the given order of words, then other words alphabetically, then unspecified."""
    keys = set(key_of.values())
    others = sorted(keys - {*order, UNSAID})
    ordered = [key for key in (*order, *others, UNSAID) if key in keys]
    return {key: sums_of(entry for entry in rows if key_of[entry.id] == key) for key in ordered}


def _cells(rows: tuple[CatalogueEntry, ...]) -> dict[tuple[str, str], CompositionSums]:
    keys = sorted({(entry.environment, entry.illumination) for entry in rows})
    return {key: sums_of(entry for entry in rows if (entry.environment, entry.illumination) == key) for key in keys}
