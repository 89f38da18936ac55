"""Modules that the fork server loads before any labelling worker starts.

**Conventions.** Importing this calls one small kernel, after which numba's tables of types and functions are there
(0.7 s); the kernels themselves are loaded where they are used. No kernel has threads, so a fork takes all of it along.
"""

import numpy as np

from stone.geometry.lattice import keys_of

keys_of(np.zeros((1, 3)), 1.0)
