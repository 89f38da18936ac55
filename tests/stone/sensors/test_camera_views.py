"""A LiDAR that looks backwards is not taken for one whose quaternion is written in the order x, y, z, w."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.camera_views import name_findings

# x right is −y, y down is −z, z forward is x
OPTICAL = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
RELLIS_WXYZ = (0.0, 0.009145, -0.000567, 0.999958)
YAWS_DEG = {"CAM_FRONT": 0.0, "CAM_LEFT": 90.0, "CAM_BACK": 180.0, "CAM_FRONT_RIGHT": -50.0, "CAM_ROOF": 10.0}


def rig(ego_from_lidar: Rotation, written: tuple[float, ...], *names: str) -> Calibration:
    """Cameras where their names say on a LiDAR with that mount, which the calibration says is `written` (wxyz)."""
    mounts = []
    for name in names:
        ego_from_camera = Rotation.from_euler("z", YAWS_DEG[name], degrees=True) * OPTICAL
        wxyz = np.roll((ego_from_lidar.inv() * ego_from_camera).as_quat(), 1)
        mounts.append(Mount(name, "camera", SE3.from_parts(wxyz, np.zeros(3))))
    return Calibration("rig", SE3.from_parts(np.array(written), np.array([0, 0, 1.3])), tuple(mounts))


def doubts(calibration: Calibration) -> list[str]:
    return [finding.severity for finding in name_findings(calibration) if finding.code == "CAL-402"]


@pytest.mark.parametrize("wxyz", [(0.0, 0.0, 0.0, 1.0), RELLIS_WXYZ, (0.02, 0.01, -0.02, -0.9995)])
def test_a_lidar_that_looks_backwards_is_not_doubted_beside_cameras_that_look_where_they_should(wxyz) -> None:
    backwards = Rotation.from_quat(np.roll(wxyz, -1))
    for names in (("CAM_FRONT",), ("CAM_LEFT", "CAM_BACK"), tuple(YAWS_DEG)):
        assert name_findings(rig(backwards, wxyz, *names)) == ()


@pytest.mark.parametrize("yaw_deg", [0.0, 8.0, -8.0])
def test_a_lidar_that_looks_ahead_and_is_written_as_xyzw_is_found_by_the_names_of_cameras(yaw_deg) -> None:
    ahead = Rotation.from_euler("z", yaw_deg, degrees=True)
    for names in (("CAM_FRONT",), ("CAM_LEFT", "CAM_BACK"), tuple(YAWS_DEG)):
        swapped = tuple(ahead.as_quat())
        assert doubts(rig(ahead, swapped, *names)) == ["warning"]
        assert doubts(rig(ahead, tuple(np.roll(swapped, 1)), *names)) == []


def test_without_a_camera_whose_name_says_a_direction_it_is_told_and_warns_of_nothing() -> None:
    for names in ((), ("CAM_ROOF",)):
        assert doubts(rig(Rotation.identity(), (0.0, 0.0, 0.0, 1.0), *names)) == ["info"]
        assert doubts(rig(Rotation.identity(), (1.0, 0.0, 0.0, 0.0), *names)) == []
