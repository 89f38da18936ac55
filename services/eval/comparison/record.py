"""The record of a comparison, as printed by the command and returned by the API.

**Conventions.** Ratios are those of `stone.scoring.metric.RATIOS` over all voxels, which are symmetric in A and B;
`agreement_ratio` is that of `stone/scoring/agreement.py`. None if undefined. Rings are horizontal distances from the
robot, half-open; the last has no end.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isnan
from typing import Any

import numpy as np

from services.eval.comparison.counting import Counted, LabelSetCounts
from stone.scoring.agreement import agreement_ratios
from stone.scoring.confusion import named_ratios
from stone.scoring.plane_layout import RING_EDGES_M

LEAST_ALIKE = 12
RINGS_M: tuple[tuple[float, float | None], ...] = tuple(zip((0.0, *RING_EDGES_M), (*RING_EDGES_M, None), strict=True))


@dataclass(frozen=True)
class ComparedFrames:
    """The frames of both sets, in order, and the numbers of frames in only one of them."""

    tokens: Sequence[str]
    only_in_a: int
    only_in_b: int


def comparison_record(frames: ComparedFrames, counts: LabelSetCounts) -> dict[str, Any]:
    """Return plain JSON values."""
    seen = counts.seen
    record: dict[str, Any] = {
        "frames": len(frames.tokens),
        "only_in_a": frames.only_in_a,
        "only_in_b": frames.only_in_b,
        "has_equal_classes": _is_diagonal(counts.confusion),
        "all_voxels": _block(counts.confusion),
        "seen_in_both": None if seen is None else _block(seen.confusion),
        "seen_voxels": None if seen is None else dict(zip(("both", "only_a", "only_b"), seen.voxels, strict=True)),
        "least_alike": _least_alike(frames.tokens, counts),
    }
    return record


def _block(by_ring: Counted) -> dict[str, Any]:
    rings = [
        {"from_m": low, "to_m": high, **_figures(counts)} for (low, high), counts in zip(RINGS_M, by_ring, strict=True)
    ]
    return {**_figures(by_ring.sum(axis=0)), "rings": rings}


def _figures(confusion: Counted) -> dict[str, Any]:
    agreement = float(agreement_ratios(confusion))
    return {
        "confusion": confusion.tolist(),
        "agreement_ratio": None if isnan(agreement) else agreement,
        "ratios": named_ratios(confusion),
    }


def _least_alike(tokens: Sequence[str], counts: LabelSetCounts) -> list[dict[str, Any]]:
    """Return the least similar frames that differ, the worst first."""
    order = np.argsort(counts.agreements, kind="stable")[:LEAST_ALIKE]  # NaN is last
    unlike = [int(index) for index in order if counts.agreements[index] < 1.0]
    return [{"token": tokens[index], "agreement_ratio": float(counts.agreements[index])} for index in unlike]


def _is_diagonal(by_ring: Counted) -> bool:
    total = by_ring.sum(axis=0)
    return bool(total.sum() == np.trace(total))
