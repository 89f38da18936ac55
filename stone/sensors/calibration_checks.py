"""Checks of a calibration before use: small faults are corrected and reported, large ones refused.

**Conventions.** Every check takes `sensor`, the name for messages, and returns findings (severity "warning", topic =
sensor) or raises a refusal. Thresholds: design §2. Rounding to four decimals leaves a rotation error of 1e-6…1e-4;
three of the 17 extrinsics published with OpenCalib exceed 5e-3 (determinants 0, 0.97, 0.999).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stone.errors import Refused, ShapeError
from stone.findings import Finding
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, CameraIntrinsics, Mount, SensorKind
from stone.sensors.calibration_errors import ImageSizeError, MissingSensorError, distortion_length, not_finite
from stone.sensors.projection import is_folded

Array = NDArray[np.float64]
Findings = tuple[Finding, ...]

ROTATION_FINE, ROTATION_LIMIT = 1e-4, 5e-3
NORM_FINE, NORM_LIMIT = 1e-3, 1e-2
TRANSLATION_FINE_M, TRANSLATION_LIMIT_M = 10.0, 100.0
FOOTPRINT_LIMIT_M = 50.0


def warning(code: str, sensor: str, sentence: str) -> Finding:
    return Finding(code, "warning", sensor, f"{sensor}: {sentence}")


def checked_transform(sensor: str, matrix: Array) -> tuple[SE3, Findings]:
    """Return a homogeneous matrix (4, 4) as SE3.

    Raises ShapeError, `CAL-416`, `CAL-407` and the errors of `checked_rotation` and `check_translation`.
    """
    if matrix.shape != (4, 4):
        raise ShapeError(f"{sensor} matrix", matrix.shape, "(4, 4)")
    if not np.isfinite(matrix).all():
        raise not_finite(sensor, "the matrix")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > ROTATION_FINE:
        raise last_row(sensor, matrix[3].tolist())
    return rotation_and_translation(sensor, matrix[:3, :3], matrix[:3, 3])


def rotation_and_translation(sensor: str, rotation: Array, translation_m: Array) -> tuple[SE3, Findings]:
    """Return a rotation matrix (3, 3) and a translation (3,) as SE3. Raises the errors of the two checks."""
    proper, findings = checked_rotation(sensor, rotation)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = proper, translation_m
    findings += check_translation(sensor, translation_m)
    return SE3.from_matrix(matrix), findings


def quaternion_and_translation(
    sensor: str, kind: SensorKind, wxyz: Array, translation_m: Array
) -> tuple[SE3, Findings]:
    """Return a quaternion (4,) declared `wxyz` and a translation (3,) as SE3, with a warning if the order is doubtful.

    Raises `CAL-416`, `CAL-402` and the errors of `check_translation`.
    """
    findings = checked_norm(sensor, wxyz) + check_translation(sensor, translation_m)
    return SE3.from_parts(wxyz, translation_m), findings + order_doubt(sensor, kind, wxyz)


def checked_rotation(sensor: str, rotation: Array) -> tuple[Array, Findings]:
    """Return the rotation (3, 3) if ‖RᵀR−I‖ and |det−1| ≤ 1e-4; up to 5e-3 the nearest rotation (SVD) and a warning.

    Raises ShapeError, `CAL-416`, `CAL-408` (det < 0), `CAL-401`.
    """
    if rotation.shape != (3, 3):
        raise ShapeError(f"{sensor} rotation", rotation.shape, "(3, 3)")
    if not np.isfinite(rotation).all():
        raise not_finite(sensor, "the rotation")
    with np.errstate(over="ignore", invalid="ignore"):
        determinant = float(np.linalg.det(rotation))
        residual = max(float(np.linalg.norm(rotation.T @ rotation - np.eye(3))), abs(determinant - 1))
    if determinant < 0:
        raise Refused(
            "CAL-408",
            f"{sensor}: the rotation has determinant {determinant:.4g}, so it contains a reflection; it must "
            "be +1 (one axis has the wrong sign, or two are swapped)",
        )
    if not residual <= ROTATION_LIMIT:
        raise Refused(
            "CAL-401",
            f"{sensor}: the matrix is not a rotation (determinant {determinant:.4g}, error {residual:.3g}, "
            f"limit {ROTATION_LIMIT:g}); was it scaled, or typed by hand?",
        )
    if residual <= ROTATION_FINE:
        return rotation, ()
    u, _, vt = np.linalg.svd(rotation)
    sentence = (
        f"the rotation has an error of {residual:.2g}; the nearest rotation is used (enter more digits in the file)"
    )
    return u @ vt, (warning("CAL-401", sensor, sentence),)


def checked_norm(sensor: str, wxyz: Array) -> Findings:
    """Return no finding within ±1e-3 of 1, a warning within ±1e-2. Raises ShapeError, `CAL-416`, `CAL-402` beyond."""
    if wxyz.shape != (4,):
        raise ShapeError(f"{sensor} quaternion", wxyz.shape, "(4,)")
    if not np.isfinite(wxyz).all():
        raise not_finite(sensor, "the quaternion")
    norm = float(np.hypot.reduce(wxyz))
    if abs(norm - 1) > NORM_LIMIT:
        raise Refused(
            "CAL-402",
            f"{sensor}: the quaternion has norm {norm:.4g}; it must be 1 ± {NORM_LIMIT:g} (a component missing or "
            "mistyped?)",
        )
    if abs(norm - 1) <= NORM_FINE:
        return ()
    return (warning("CAL-402", sensor, f"the quaternion has norm {norm:.4f} and is normalised (rounded in the file?)"),)


def order_doubt(sensor: str, kind: SensorKind, wxyz: Array) -> Findings:
    """Return a warning if the quaternion read as xyzw would be a much more plausible, upright mount.

    A sensor is expected upright within 60°: cameras with image down (+y) along −z, all others with +z up. Half a turn
    about the vertical gives no warning: left radars next to a Hesai (y forward) have it, as do LiDARs that look
    backwards. For these, the cameras' names decide (`stone.sensors.camera_views`).
    """
    declared, other = SE3.from_parts(wxyz, np.zeros(3)), SE3.from_parts(np.roll(wxyz, 1), np.zeros(3))
    up = np.array([0.0, -1.0, 0.0]) if kind == "camera" else np.array([0.0, 0.0, 1.0])
    is_tilted, is_upright = (declared @ up)[2] < 0.5, (other @ up)[2] > 0.9
    if not (is_tilted and is_upright):
        return ()
    order = (
        "the quaternion is read in the declared order wxyz, but the order xyzw gives a more plausible mount; "
        "check the order"
    )
    return (warning("CAL-402", sensor, order),)


def check_translation(sensor: str, translation_m: Array) -> Findings:
    """Return a warning beyond 10 m. Raises ShapeError, `CAL-416`, `CAL-409` beyond 100 m."""
    if translation_m.shape != (3,):
        raise ShapeError(f"{sensor} translation", translation_m.shape, "(3,)")
    if not np.isfinite(translation_m).all():
        raise not_finite(sensor, "the translation")
    distance_m = float(np.hypot.reduce(translation_m))
    if distance_m > TRANSLATION_LIMIT_M:
        raise Refused(
            "CAL-409",
            f"{sensor}: the translation is {distance_m:.4g} m long; the limit is {TRANSLATION_LIMIT_M:g} m (in "
            "millimetres?)",
        )
    if distance_m <= TRANSLATION_FINE_M:
        return ()
    return (warning("CAL-409", sensor, f"the sensor is {distance_m:.1f} m from the LiDAR (unit not metres?)"),)


def require_mounts(calibration: Calibration, names: tuple[str, ...], why: str) -> None:
    """Raise MissingSensorError with all `names` that the calibration does not have."""
    missing = [name for name in names if calibration.mount(name) is None]
    if missing:
        raise MissingSensorError(missing, [mount.name for mount in calibration.mounts], why)


def check_calibration(calibration: Calibration) -> Findings:
    """Return findings about the whole: unique channels, footprint and self boxes with an extent, no identical mounts.

    Raises `CAL-413`, `CAL-415`.
    """
    names = [mount.name for mount in calibration.mounts]
    for name in names:
        if names.count(name) > 1:
            raise Refused("CAL-413", f"{name} is in the calibration twice; channels must be unique")
    for key, value_m in (("length_m", calibration.footprint.length_m), ("width_m", calibration.footprint.width_m)):
        if not 0 < value_m <= FOOTPRINT_LIMIT_M:
            raise Refused(
                "CAL-415", f"footprint {key} is {value_m:g} m; expected more than 0 and at most {FOOTPRINT_LIMIT_M:g} m"
            )
    for index, box in enumerate(calibration.self_boxes_ego):
        if not all(low < high for low, high in zip(box.min_m, box.max_m, strict=True)):
            raise Refused(
                "CAL-415", f"self box {index} is {box.min_m} to {box.max_m}; expected min below max on every axis"
            )
    return _unmeasured_mounts(calibration) + _sunken_lidar(calibration)


def _sunken_lidar(calibration: Calibration) -> Findings:
    """Return a warning for a LiDAR below the ego origin, which is on the ground."""
    height_m = float(calibration.ego_from_lidar.translation_m[2])
    if height_m >= 0:
        return ()
    sentence = (
        f"the LiDAR is {-height_m:.2f} m under the ground (is the transform inverted, or the ego origin not on the "
        "ground?)"
    )
    return (warning("CAL-419", "ego_from_lidar", sentence),)


def _unmeasured_mounts(calibration: Calibration) -> Findings:
    """Return a warning if several sensors are exactly at the LiDAR: extrinsics that were never filled in."""
    identity = SE3.identity().wxyz_xyz
    on_lidar = [m.name for m in calibration.mounts if np.array_equal(m.lidar_from_sensor.wxyz_xyz, identity)]
    if len(on_lidar) < 2:
        return ()
    return (warning("CAL-417", ", ".join(on_lidar), "the extrinsics are the identity; were they never measured?"),)


# Checks of a camera's intrinsics before any projection, with the conventions above.


DISTORTION_LENGTHS = {"pinhole": 0, "plumb_bob": 5, "rational_polynomial": 8, "equidistant": 4}
FOCAL_RATIO_USUAL = (0.2, 5.0)
OFF_CENTRE_RATIO_LIMIT = 0.15
ASPECT_TOLERANCE_RATIO = 0.05


def check_intrinsics(sensor: str, camera: CameraIntrinsics) -> Findings:
    """Return warnings for unusual focal lengths and principal points, and for a lens that folds its image.

    Raises `CAL-416`, `CAL-410`, `CAL-411` (focal length ≤ 0, principal point off the image).
    """
    expected = DISTORTION_LENGTHS[camera.model]
    if len(camera.distortion) != expected:
        raise distortion_length(sensor, camera.model, len(camera.distortion), expected)
    if not np.isfinite((camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)).all():
        raise not_finite(sensor, "the intrinsics")
    findings = _check_axis(sensor, "x", camera.fx_px, camera.cx_px, camera.width_px)
    findings += _check_axis(sensor, "y", camera.fy_px, camera.cy_px, camera.height_px)
    if abs(camera.fx_px / camera.fy_px - 1) > ASPECT_TOLERANCE_RATIO:
        sentence = f"fx/fy is {camera.fx_px / camera.fy_px:.3f}, but pixels are square"
        findings += (warning("CAL-411", sensor, sentence),)
    if is_folded(camera):
        sentence = (
            f"the {camera.model} distortion turns back before the image's corner (does it belong to another camera "
            "or model?)"
        )
        findings += (warning("CAL-411", sensor, sentence),)
    return findings


def check_image_size(mount: Mount, width_px: int, height_px: int) -> None:
    """Raise ImageSizeError if the mount's intrinsics belong to another image size."""
    camera = mount.intrinsics
    if camera is not None and (camera.width_px, camera.height_px) != (width_px, height_px):
        raise ImageSizeError(mount.name, (camera.width_px, camera.height_px), (width_px, height_px))


def _check_axis(sensor: str, axis: str, focal_px: float, centre_px: float, size_px: int) -> Findings:
    if focal_px <= 0:
        raise camera_matrix(sensor, f"f{axis}_px", focal_px, "a positive focal length")
    if not 0 < centre_px < size_px:
        raise camera_matrix(sensor, f"c{axis}_px", centre_px, f"inside the image, 0 to {size_px}")
    findings: Findings = ()
    if not FOCAL_RATIO_USUAL[0] <= focal_px / size_px <= FOCAL_RATIO_USUAL[1]:
        findings += (warning("CAL-411", sensor, f"f{axis}_px {focal_px:.1f} is unusual for {size_px} px"),)
    if abs(centre_px / size_px - 0.5) > OFF_CENTRE_RATIO_LIMIT:
        findings += (warning("CAL-411", sensor, f"c{axis}_px {centre_px:.1f} is far from the middle of {size_px} px"),)
    return findings


def last_row(sensor: str, row: Sequence[float]) -> Refused:
    shown = ", ".join(f"{value:.4g}" for value in row)
    return Refused("CAL-407", f"{sensor}: the last row of the matrix is ({shown}), not (0, 0, 0, 1); is it transposed?")


def camera_matrix(sensor: str, key: str, value: float, expected: str) -> Refused:
    return Refused("CAL-411", f"{sensor}: {key} is {value:.6g} px; expected {expected} (rows and columns swapped?)")
