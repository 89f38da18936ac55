"""Compiled kernels for imports, loaded in the process that forks children: kernels of labelling and of label maps.

**Conventions.** As in `services/labeler/kernel_warmup.py`: a child cannot keep what it compiles, so a small map is made
here in the same way as in children.
"""

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from services.labeler.imports.fused_labels import FusedLabels
from services.labeler.imports.label_counts import class_counts
from services.labeler.imports.map_products import exposed_faces
from services.labeler.kernel_warmup import warm, warmup_sequence
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER

HEIGHT, SIDE = 9, slice(120, 136)


@cache
def warm_imports() -> None:
    """Warm all kernels of labelling, and make the map of one small frame, once per process.

    Its classes are read-only like those of a file, and also writable like those from a class map.
    """
    warm()
    classes = np.zeros(PAPER.shape, np.uint8)
    classes[SIDE, SIDE, HEIGHT] = 1
    with TemporaryDirectory(prefix="stone-warmup-") as folder:
        fused = FusedLabels("warmup", Path(folder) / "votes")
        for is_mapped in (True, False):
            classes.flags.writeable = is_mapped
            class_counts(classes)
            fused.add(classes, warmup_sequence().frames.map_from_ego[0])
        for _tile, keys, kinds in fused.tiles():
            exposed_faces(keys, kinds, VOXEL_M)
