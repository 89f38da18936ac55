"""Checks of a camera's intrinsics before anything is projected with them.

**Conventions.** As in `stone.sensors.calibration_checks`: findings are returned, refusals raised, thresholds from
design §2.
"""

import numpy as np

from stone.sensors.calibration import CameraIntrinsics, Mount
from stone.sensors.calibration_checks import Findings, warning
from stone.sensors.calibration_errors import CameraMatrixError, DistortionLengthError, ImageSizeError, NotFiniteError
from stone.sensors.projection import is_folded

DISTORTION_LENGTHS = {"pinhole": 0, "plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
FOCAL_RATIO_USUAL = (0.2, 5.0)
OFF_CENTRE_RATIO_LIMIT = 0.15
ASPECT_TOLERANCE_RATIO = 0.05


def check_intrinsics(sensor: str, camera: CameraIntrinsics) -> Findings:
    """Warnings for unusual focal lengths and principal points, and for a lens that folds its image over.

    Raises NotFiniteError, DistortionLengthError, CameraMatrixError (focal length ≤ 0, principal point off the image).
    """
    expected = DISTORTION_LENGTHS[camera.model]
    if len(camera.distortion) != expected:
        raise DistortionLengthError(sensor, camera.model, len(camera.distortion), expected)
    if not np.isfinite((camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)).all():
        raise NotFiniteError(sensor, "the intrinsics")
    findings = _check_axis(sensor, "x", camera.fx_px, camera.cx_px, camera.width_px)
    findings += _check_axis(sensor, "y", camera.fy_px, camera.cy_px, camera.height_px)
    if abs(camera.fx_px / camera.fy_px - 1) > ASPECT_TOLERANCE_RATIO:
        sentence = f"fx/fy is {camera.fx_px / camera.fy_px:.3f}, but pixels are square"
        findings += (warning("CAL-411", sensor, sentence),)
    if is_folded(camera):
        sentence = f"the {camera.model} distortion turns back before the image's corner (of another camera or model?)"
        findings += (warning("CAL-411", sensor, sentence),)
    return findings


def check_image_size(mount: Mount, width_px: int, height_px: int) -> None:
    """Raises ImageSizeError when the mount's intrinsics are for images of another size."""
    camera = mount.intrinsics
    if camera is not None and (camera.width_px, camera.height_px) != (width_px, height_px):
        raise ImageSizeError(mount.name, (camera.width_px, camera.height_px), (width_px, height_px))


def _check_axis(sensor: str, axis: str, focal_px: float, centre_px: float, size_px: int) -> Findings:
    if focal_px <= 0:
        raise CameraMatrixError(sensor, f"f{axis}_px", focal_px, "a positive focal length")
    if not 0 < centre_px < size_px:
        raise CameraMatrixError(sensor, f"c{axis}_px", centre_px, f"inside the image, 0 to {size_px}")
    findings: Findings = ()
    if not FOCAL_RATIO_USUAL[0] <= focal_px / size_px <= FOCAL_RATIO_USUAL[1]:
        findings += (warning("CAL-411", sensor, f"f{axis}_px {focal_px:.1f} is unusual for {size_px} px"),)
    if abs(centre_px / size_px - 0.5) > OFF_CENTRE_RATIO_LIMIT:
        findings += (warning("CAL-411", sensor, f"c{axis}_px {centre_px:.1f} is far from the middle of {size_px} px"),)
    return findings
