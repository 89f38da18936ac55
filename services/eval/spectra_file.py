"""The file by which a score is compared with others: its `RatioSpectra`.

**Conventions.** The spectra of two scores by one ground truth determine how surely the two differ.
"""

import numpy as np

from stone.scoring.intervals import RatioSpectra
from stone_files.npz import npz_bytes


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
