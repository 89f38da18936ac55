"""The file for comparing a score with others: its `RatioSpectra`.

**Conventions.** The spectra of two scores by one ground truth determine the significance of their difference.
"""

import numpy as np

from stone.scoring.intervals import RatioSpectra
from stone_files.npz import npz_bytes


def spectra_npz(spectra: RatioSpectra) -> bytes:
    """Return the spectra as a file; equal spectra give equal bytes."""
    return npz_bytes(
        {
            "frames_of_sequence": np.array(spectra.layout.frames_of_sequence, np.int64),
            "coefficients": spectra.coefficients.astype(np.float32),
            "sequence_weight": spectra.sequence_weight.astype(np.float32),
            "spread": spectra.spread.astype(np.float32),
        }
    )
