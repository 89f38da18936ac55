"""Loaded into the fork server before any worker: what every worker would otherwise do for itself.

**Conventions.** Importing this calls one small kernel, after which numba's tables of types and functions are there
(0.7 s); the kernels themselves are loaded where they are used. No kernel has threads, so a fork takes all of it along.
"""

import numpy as np

import services.labeler.frames
import services.labeler.fuse
import services.labeler.surface  # noqa: F401
from stone.lattice import keys_of

keys_of(np.zeros((1, 3)), 1.0)
