"""A confusion counted the plain way: the oracle of the kernels that count by bits."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Counts = NDArray[np.integer[Any]]


def confusion_matrix(truth: Counts, prediction: Counts, is_evaluated: NDArray[np.bool_]) -> NDArray[np.int64]:
    """[truth, prediction] (4, 4) of two label arrays 0–3 of one shape."""
    assert truth.shape == prediction.shape == is_evaluated.shape
    pairs = truth[is_evaluated].astype(np.int64) * 4 + prediction[is_evaluated]
    return np.bincount(pairs, minlength=16).reshape(4, 4).astype(np.int64)
