"""Do the calibrated cameras look where the LiDAR measures? The physical test that finds an inverted transform.

**Conventions.** A camera must see more than 5 % of a sweep's points (less for a lens narrower than 36°) and look where
its name says (design §2). Where it does not and the transform read the other way round does, the finding says so.
Errors are findings here: labels need no camera, so a recording with a wrong one is still of use.
"""

from dataclasses import replace

import numpy as np

from services.ingest.bag import Bag
from services.ingest.camera_sweeps import Pair, pairs
from services.ingest.sweeps import BagSweeps
from stone.calibration import Mount
from stone.camera_views import View, least_seen_ratio, view_of
from stone.findings import Finding
from stone.se3 import SE3
from stone.sequence import Sequence

SAMPLED_FRAMES = 3
EGO_FROM_LIDAR = "ego_from_lidar"


def projection_findings(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """CAL-404 for each camera that fails the physical test, or one for `ego_from_lidar` where that explains them all.

    None without cameras. Raises what `sweeps.sweep` raises.
    """
    sampled: dict[str, list[Pair]] = {}
    for pair in pairs(sequence, sweeps, SAMPLED_FRAMES):
        sampled.setdefault(pair.mount.name, []).append(pair)
    ego_from_lidar = sequence.calibration.ego_from_lidar
    wrong = {name: found for name, found in sampled.items() if _is_wrong(found, ego_from_lidar)}
    if len(wrong) > 1 and not any(_is_wrong(found, ego_from_lidar.inverse()) for found in sampled.values()):
        return (_ego_finding(len(wrong)),)
    return tuple(_finding(found, ego_from_lidar) for found in wrong.values())


def _is_wrong(found: list[Pair], ego_from_lidar: SE3) -> bool:
    view = _median_view(found, ego_from_lidar)
    return view.is_wrong(_least(found[0].mount))


def _median_view(found: list[Pair], ego_from_lidar: SE3) -> View:
    views = [view_of(pair.mount, ego_from_lidar, pair.points_camera) for pair in found]
    return replace(views[0], seen_ratio=float(np.median([view.seen_ratio for view in views])))


def _least(mount: Mount) -> float:
    return least_seen_ratio(mount.intrinsics) if mount.intrinsics is not None else 0.0


def _turned(pair: Pair) -> Pair:
    """The pair as if the file's `lidar_from_camera` were `camera_from_lidar`; the motion, a few cm, is left out."""
    mount = replace(pair.mount, lidar_from_sensor=pair.mount.lidar_from_sensor.inverse())
    return replace(pair, mount=mount, camera_from_lidar=pair.mount.lidar_from_sensor)


def _finding(found: list[Pair], ego_from_lidar: SE3) -> Finding:
    mount, view = found[0].mount, _median_view(found, ego_from_lidar)
    other = _median_view([_turned(pair) for pair in found], ego_from_lidar)
    sentence = f"{mount.name}: {view.seen_ratio * 100:.1f} % of the LiDAR's points project into it"
    sentence += f" (more than {_least(mount) * 100:.1f} % expected)"
    if view.off_name_deg is not None:
        sentence += f" and it looks {view.off_name_deg:.0f}° from where its name says"
    is_inverted = other.is_plausible and not other.is_wrong(_least(mount))
    likely = (
        "; the transform is inverted: read as camera_from_lidar it fits" if is_inverted else "; is it this camera's?"
    )
    return Finding("CAL-404", "error", mount.name, sentence + likely)


def _ego_finding(count: int) -> Finding:
    sentence = (
        f"{EGO_FROM_LIDAR}: {count} cameras look away from where their names say, and all fit once it is turned "
        "round; the transform is inverted: it is lidar_from_ego"
    )
    return Finding("CAL-404", "error", EGO_FROM_LIDAR, sentence)
