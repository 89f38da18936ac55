"""What a dataset is made of, as a JSON record for pages, figures and manifests.

**Conventions.** Lists are in the order in which they are shown; '' is what was not said. `voxels` are those of frames
by class, null where no sequence's are known or to be told; `voxels_known` and `distances_known` say how many sequences
the sums are of.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from stone.composition import CatalogueEntry, Composition, Tally, composition_of, tally_of

Record = dict[str, Any]
CLASSES = ("traversable", "potentially_traversable", "non_traversable")


def statistics_record(parts: Mapping[str, Iterable[CatalogueEntry]]) -> Record:
    """Of the sequences of these parts; '' is the part of what is in none."""
    of_parts = {part: tuple(entries) for part, entries in parts.items()}
    composition = composition_of(entry for entries in of_parts.values() for entry in entries)
    shown = {part: tally_of(entries) for part, entries in of_parts.items() if entries}
    return {
        "total": tally_record(composition.total),
        "parts": _listed(shown),
        "environments": _listed(composition.environments),
        "illuminations": _listed(composition.illuminations),
        "halves": _listed(composition.halves),
        "regions": _listed(composition.regions),
        "cells": _cells(composition),
    }


def tally_record(tally: Tally) -> Record:
    shares = tally.class_shares()
    return {
        "sequences": tally.sequences,
        "frames": tally.frames,
        "duration_s": round(tally.duration_s, 3),
        "distance_m": round(tally.distance_m, 3) if tally.measured else None,
        "distances_known": tally.measured,
        "voxels": dict(zip(CLASSES, tally.voxels, strict=True)) if tally.counted else None,
        "class_ratios": dict(zip(CLASSES, shares, strict=True)) if shares else None,
        "voxels_known": tally.counted,
    }


def _listed(tallies: Mapping[str, Tally]) -> list[Record]:
    return [{"key": key, **tally_record(tally)} for key, tally in tallies.items()]


def _cells(composition: Composition) -> list[Record]:
    return [
        {"environment": environment, "illumination": illumination, **tally_record(tally)}
        for (environment, illumination), tally in composition.cells.items()
    ]
