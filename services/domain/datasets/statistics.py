"""Dataset statistics as a JSON record.

**Conventions.** Lists are in display order; '' means not specified. `voxels` are the frames' voxels by class, null if
unknown or withheld for all sequences; `voxels_known` and `distances_known` count the sequences in the sums. The
held-out recall covers all judged metres together; the gravest finding is that of any sequence.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from stone.splits.composition import CatalogueEntry, Composition, CompositionSums, composition_of, sums_of

Record = dict[str, Any]
CLASSES = ("traversable", "potentially_traversable", "non_traversable")


def statistics_record(parts: Mapping[str, Iterable[CatalogueEntry]]) -> Record:
    """Return the statistics of the sequences of these parts; part '' contains unassigned sequences."""
    of_parts = {part: tuple(entries) for part, entries in parts.items()}
    composition = composition_of(entry for entries in of_parts.values() for entry in entries)
    shown = {part: sums_of(entries) for part, entries in of_parts.items() if entries}
    return {
        "total": counts_record(composition.total),
        "parts": _listed(shown),
        "environments": _listed(composition.environments),
        "illuminations": _listed(composition.illuminations),
        "halves": _listed(composition.halves),
        "regions": _listed(composition.regions),
        "cells": _cells(composition),
    }


def counts_record(sums: CompositionSums) -> Record:
    shares = sums.class_shares()
    return {
        "sequences": sums.sequences,
        "drives": sums.drives,
        "frames": sums.frames,
        "duration_s": round(sums.duration_s, 3),
        "distance_m": round(sums.distance_m, 3) if sums.measured else None,
        "distances_known": sums.measured,
        "voxels": dict(zip(CLASSES, sums.voxels, strict=True)) if sums.counted else None,
        "class_ratios": dict(zip(CLASSES, shares, strict=True)) if shares else None,
        "voxels_known": sums.counted,
        "held_out_known": sums.judged,
        **sums.quality.as_record(),
    }


def _listed(sums_by_key: Mapping[str, CompositionSums]) -> list[Record]:
    return [{"key": key, **counts_record(sums)} for key, sums in sums_by_key.items()]


def _cells(composition: Composition) -> list[Record]:
    return [
        {"environment": environment, "illumination": illumination, **counts_record(sums)}
        for (environment, illumination), sums in composition.cells.items()
    ]
