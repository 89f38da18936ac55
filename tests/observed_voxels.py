"""What was observed, voxel by voxel: bricks of bits taken apart."""

import numpy as np

from stone.geometry.lattice import Keys, indices_of, keys_from_indices
from stone.labels.observed_voxels import BRICK, Observed


def voxel_keys(observed: Observed) -> Keys:
    """The keys of all observed voxels on the `VOXEL_M` lattice."""
    bits = np.unpackbits(observed.words.astype("<u8").view(np.uint8), bitorder="little").reshape(-1, 64)
    brick, bit = np.nonzero(bits)
    corner = np.stack([bit >> 4, (bit >> 2) & 3, bit & 3], axis=1)
    return keys_from_indices(indices_of(observed.keys[brick]) * BRICK + corner)
