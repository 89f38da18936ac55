"""Limits numerical libraries to one thread per process on import; jobs provide the parallelism.

**Conventions.** Import it before numpy, Open3D and numba, which read these variables when they are loaded. Variables
that are already set take precedence.
"""

import os

VARIABLES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "MKL_NUM_THREADS")

for name in VARIABLES:
    os.environ.setdefault(name, "1")
