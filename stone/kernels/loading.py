"""The first call of a kernel in a process, made before a kernel is needed."""

import numpy as np

from stone.geometry.lattice import keys_of


def load_compiler() -> None:
    """Have numba load its tables of types and functions, which the first call of any kernel waits for (0.3 s)."""
    keys_of(np.zeros((1, 3)), 1.0)
