"""A flat analytic world with one thing of each kind where a test knows it."""

from functools import cache

import numpy as np

from testing.outside.ground import Ground
from testing.outside.solids import BOX, CYLINDER, ELLIPSOID, GRASS, Solid, as_rows
from testing.outside.track import Track
from testing.outside.truth import Truth
from testing.outside.worlds import World

FLAT = Ground(np.zeros((0, 4)), np.zeros((0, 2)), np.zeros((0, 7)), np.zeros((0, 6)))
SHAPED = FLAT._replace(
    mounds=np.array([[0.0, 20.0]]),
    ditches=np.array([[0.0, -10.0, 0.0, 5.0, 0.7, 0.3, 1.0]]),
    banks=np.array([[0.0, -20.0, 0.0, 4.0, 0.3, 4.0]]),
)
SOLIDS = [
    Solid("trunk", CYLINDER, (10.0, 10.0, 2.0), (0.2, 0.2, 2.0)),
    Solid("crown", ELLIPSOID, (10.0, 10.0, 4.2), (1.6, 1.6, 1.5), free_path_m=0.6),
    Solid("roof", BOX, (20.0, 10.0, 2.8), (1.0, 1.0, 0.1)),
    Solid("bar", BOX, (15.0, -5.0, 0.7), (1.0, 0.06, 0.1)),
    Solid("small rock", ELLIPSOID, (5.0, 5.0, 0.0), (0.2, 0.2, 0.15)),
    Solid("rock", ELLIPSOID, (7.0, 5.0, 0.0), (0.3, 0.3, 0.4)),
    Solid("grass", GRASS, (20.0, -10.0, 0.0), (2.0, 2.0, 0.15), free_path_m=0.6),
]


@cache
def known_truth() -> Truth:
    """Return the truth of a world of `SHAPED` ground and `SOLIDS`, driven through for 10 s."""
    return Truth(World("known", SHAPED, as_rows(SOLIDS), Track(SHAPED, 10.0), walker_x_m=8.0))
