"""The first kernel call of a process, made before a kernel is needed."""

import numpy as np

from stone.geometry.lattice import keys_of


def load_compiler() -> None:
    """Load numba's tables of types and functions, which otherwise delays the first call of a kernel by 0.3 s."""
    keys_of(np.zeros((1, 3)), 1.0)
