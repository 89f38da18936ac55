"""The held-out track of a run: a reference from one part of the track, judged on the other part.

**Conventions.** Only the reference and the classes are recomputed. The surface and its features are those of the whole
run, which also contain later sweeps. The track is cut in the middle, by driven metres, or elsewhere for a benchmark.
"""

from collections.abc import Sequence as Listing
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.labeler.frames import squared_distances
from services.labeler.map.surface import TileSummary
from services.labeler.run import LabelRun
from stone.errors import Refused
from stone.findings import Finding
from stone.geometry.lattice import centres_of
from stone.labels.footprint import Passes
from stone.labels.held_out import BANDS_M, DrivenPlaces, HeldOut, held_out
from stone.labels.profiles import VoxelTerrain
from stone.labels.traversability import reference_of_parts, threshold
from stone.labels.voxels import VOXEL_M

HALF = 0.5
HALVES = ("from_first_half", "from_second_half")
FEWEST_KNOWN, FEWEST_JUDGED = 100, 100
ENOUGH_KNOWN_M = 12.0  # labels from 7 m of track fit a third of other ground even in sound runs
# Sound drives through three worlds with three seeds have at least 0.76; the lowest has a sixth of its track in tall
# grass (profile `field`, `make bench-outside`).
POOR_RECALL, FAIR_RECALL = 0.6, 0.75


class HeldOutTrack:
    """The driven voxels of all tiles, which can be divided anywhere along the track."""

    def __init__(self, run: LabelRun, tiles: Listing[TileSummary]) -> None:
        self._run = run
        driven = [tile.driven for tile in tiles]
        self._terrain = VoxelTerrain(
            np.concatenate([terrain.keys for terrain in driven]),
            np.concatenate([terrain.columns for terrain in driven]),
        )
        self._passes = Passes(
            np.concatenate([tile.passes.first_m for tile in tiles]),
            np.concatenate([tile.passes.last_m for tile in tiles]),
        )
        maps = np.repeat([tile.tile.map for tile in tiles], [len(terrain) for terrain in driven])
        self._places = DrivenPlaces(centres_of(self._terrain.keys, VOXEL_M)[:, :2], maps)

    def from_first(self, ratio: float = HALF) -> HeldOut | None:
        """Return how labels from the first `ratio` of the track fit the rest; None if there is too little ground."""
        at_m = ratio * self._passes.last_m.max(initial=0.0)
        is_known = self._passes.first_m <= at_m
        return self._held(is_known, ~is_known)

    def from_last(self, ratio: float = HALF) -> HeldOut | None:
        """Return how labels from the last `ratio` of the track fit the ground driven before."""
        at_m = (1.0 - ratio) * self._passes.last_m.max(initial=0.0)
        is_known = self._passes.last_m >= at_m
        return self._held(is_known, ~is_known)

    def _held(self, is_known: NDArray[np.bool_], is_judged: NDArray[np.bool_]) -> HeldOut | None:
        if is_known.sum() < FEWEST_KNOWN or is_judged.sum() < FEWEST_JUDGED:
            return None
        run, parameters = self._run, self._run.parameters
        features = self._terrain.where(is_known).features(parameters.rule)
        try:
            reference = reference_of_parts([features], features.mean(axis=0), parameters.reference)
        except Refused:
            return None
        squared = squared_distances(run, self._terrain.where(is_judged), reference, parameters)
        is_kept = squared <= threshold(parameters.reference.alpha)
        places, width_m = self._places, run.sequence.calibration.footprint.width_m
        return held_out(places.where(is_known), places.where(is_judged), is_kept, width_m)


def held_out_record(track: HeldOutTrack) -> dict[str, Any]:
    """Return the figures of both halves for `report.json`, and their common `recall`.

    A half without enough ground of its own is null.
    """
    halves = dict(zip(HALVES, (track.from_first(), track.from_last()), strict=True))
    known = [half for half in halves.values() if half is not None]
    total = sum(int(half.voxels.sum()) for half in known)
    kept = sum(int(half.kept.sum()) for half in known)
    return {
        "recall": round(kept / total, 4) if total else None,
        "judged_m": round(sum(half.judged_m for half in known), 1),
        **{name: None if half is None else _record(half) for name, half in halves.items()},
    }


def _record(held_out: HeldOut) -> dict[str, Any]:
    bands = [
        {
            "from_m": low,
            "to_m": None if np.isinf(high) else high,
            "voxels": int(voxels),
            "recall": round(float(kept / voxels), 4) if voxels else None,
        }
        for low, high, voxels, kept in zip(BANDS_M[:-1], BANDS_M[1:], held_out.voxels, held_out.kept, strict=True)
    ]
    figures = {"recall": held_out.recall, "judged_m": held_out.judged_m, "known_m": held_out.known_m}
    return {name: round(value, 4 if name == "recall" else 1) for name, value in figures.items()} | {
        "by_distance": bands
    }


def held_out_findings(record: dict[str, Any]) -> tuple[Finding, ...]:
    """Return LAB-613 if the labels classify much of the ground driven later as non-traversable, LAB-614 if some."""
    recall, halves = record["recall"], [record[name] for name in HALVES if record[name] is not None]
    if recall is None or recall >= FAIR_RECALL or any(half["known_m"] < ENOUGH_KNOWN_M for half in halves):
        return ()
    sentence = (
        f"labels made from one half of the track classify {1 - recall:.0%} of the ground driven over in the other "
        f"half as non-traversable ({record['judged_m']:g} m of track were judged). Similar ground elsewhere is "
        "probably misclassified too"
    )
    return (Finding("LAB-613" if recall < POOR_RECALL else "LAB-614", "warning", "", sentence),)
