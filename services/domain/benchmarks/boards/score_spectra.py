"""Reads the spectra that are kept of a score.

**Conventions.** The file is ours (`services/eval/score_intervals.py` writes it), so what it holds is believed. Scores
whose metric's intervals are withdrawn may have another file, from which nothing is read.
"""

import io

import numpy as np

from services.runtime.store.protocol import Store
from stone.scoring.intervals import RatioSpectra
from stone.scoring.spectra import layout_of


def read_spectra(store: Store, object_key: str) -> RatioSpectra | None:
    """The spectra of a score; None where bootstrap replicates were kept. Raises `StoreAwayError`."""
    with np.load(io.BytesIO(b"".join(store.read(object_key))), allow_pickle=False) as arrays:
        if "coefficients" not in arrays:
            return None
        return RatioSpectra(
            layout_of(arrays["frames_of_sequence"].tolist()),
            arrays["coefficients"],
            arrays["sequence_weight"],
            arrays["spread"],
        )
