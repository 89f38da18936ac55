"""The check that some sweep shows ground under the footprint: without it labels have no reference.

**Conventions.** A return counts if its voxel is under the footprint at, or between, any poses of its map, grown by the
reach of the reconstructed surface beyond returns. The search ends at the first sweep with such a return; in a sound
run this is the first or second sweep.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from stone.errors import Refused
from stone.geometry.lattice import keys_of
from stone.geometry.se3 import SE3
from stone.labels.footprint import passes
from stone.labels.traversability import no_reference
from stone.labels.voxels import VOXEL_M
from stone.sensors.ego_path import ego_path, maps_of_frames
from stone.sensors.ground_plane import BAND_M
from stone.sensors.sequence import Sequence, SweepSource
from stone_recordings.sync.ground_looks import seen_around

MOST_FRAMES = 400  # frames tried in a longer run; some of them show the ground
REACH_M = VOXEL_M


def reference_refusal(sequence: Sequence, sweeps: SweepSource) -> Refused | None:
    """Return labelling's refusal of a run in which no sweep shows ground under the footprint; None if one does."""
    count = len(sequence.frames)
    if not 0 < count <= MOST_FRAMES:
        return None
    given, maps = sequence.calibration.footprint, maps_of_frames(sequence)
    footprint = replace(given, length_m=given.length_m + 2 * REACH_M, width_m=given.width_m + 2 * REACH_M)

    @cache
    def path_of(number: int) -> tuple[SE3, ...]:
        return ego_path(sequence, number)

    for row in range(count):
        points_ego = seen_around(sequence, sweeps, row).astype(np.float64)
        keys = np.unique(keys_of(sequence.frames.map_from_ego[row] @ points_ego, VOXEL_M))
        if passes(keys, path_of(int(maps[row])), footprint, BAND_M + REACH_M).is_driven.any():
            return None
    return no_reference(0)
