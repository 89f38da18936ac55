"""Intervals of a score as its record has them, and the file by which it is compared with others.

**Conventions.** By scope (`these_places`, `new_place`) and ratio: `intervals` has [low, high] or None, `silences` the
code of why there is none (`stone.scoring.silences`), or None. The file holds the `RatioSpectra` of the score;
of two scores by one ground truth they say how surely the two differ.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from stone.scoring.confusion import Counts
from stone.scoring.intervals import Estimate, RatioSpectra, estimates, ratio_spectra
from stone.scoring.metric import RATIOS, Metric
from stone.scoring.silences import SCOPES, UNKNOWN_ORDER, WITHDRAWN, Silence
from stone_files.npz import npz_bytes

Ratios = Mapping[str, float | None]


def spectra_of(confusions: Counts, frames_of_sequence: tuple[int, ...], metric: Metric) -> RatioSpectra:
    """Of confusions [F, ring, 4, 4] in time order inside each sequence. Raises `ShapeError`."""
    return ratio_spectra(confusions.sum(axis=1, dtype=np.int64), frames_of_sequence, metric.version)


def interval_record(
    total: Ratios, spectra: RatioSpectra, metric: Metric, *, is_in_time_order: bool = True
) -> dict[str, Any]:
    """`intervals` and `silences` of a score's totals; a metric whose intervals are withdrawn has none.

    Where the order of the frames in time is unknown, nothing is said of these places: neighbours that are alike would
    pass for independent ones, and the interval would be too narrow.
    """
    values = np.array([np.nan if total[name] is None else total[name] for name in RATIOS], np.float64)
    found = {scope: estimates(values, spectra, scope) for scope in SCOPES}
    if not is_in_time_order:
        found["these_places"] = tuple(UNKNOWN_ORDER if np.isfinite(value) else "undefined" for value in values)
    if metric.successor is not None:
        found = dict.fromkeys(SCOPES, (WITHDRAWN,) * len(RATIOS))
    return {
        "intervals": {
            scope: dict(zip(RATIOS, map(_bounds, of_scope), strict=True)) for scope, of_scope in found.items()
        },
        "silences": {
            scope: dict(zip(RATIOS, map(_silence, of_scope), strict=True)) for scope, of_scope in found.items()
        },
    }


def spectra_npz(spectra: RatioSpectra) -> bytes:
    """The same spectra, the same bytes."""
    return npz_bytes(
        {
            "frames_of_sequence": np.array(spectra.layout.frames_of_sequence, np.int64),
            "coefficients": spectra.coefficients.astype(np.float32),
            "sequence_weight": spectra.sequence_weight.astype(np.float32),
            "spread": spectra.spread.astype(np.float32),
        }
    )


def _bounds(found: Estimate | Silence) -> list[float] | None:
    return None if isinstance(found, str) else list(found.ratio_interval())


def _silence(found: Estimate | Silence) -> Silence | None:
    return found if isinstance(found, str) else None
