"""Projection of points into a camera's image, by each of the four lens models.

    pinhole              u = fx x/z + cx,  v = fy y/z + cy
    plumb_bob            radial k1 k2 k3, tangential p1 p2 (Brown 1966), as (k1, k2, p1, p2, k3)
    rational_polynomial  (1 + k1 r² + k2 r⁴ + k3 r⁶) / (1 + k4 r² + k5 r⁴ + k6 r⁶), as (k1, k2, p1, p2, k3, k4, k5, k6)
    equidistant          θ_d = θ (1 + k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸) (Kannala and Brandt 2006)

**Conventions.** Points are in the optical frame: z forward, x right, y down. Pixel (0, 0) is the centre of the first
pixel, so an image extends from −0.5 to size − 0.5. A distortion polynomial turns back outside its fitted image and
would project points far off the axis into the image: points beyond the turn are never in the image.
"""

import numpy as np
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.sensors.calibration import CameraIntrinsics

Array = NDArray[np.float64]

LEAST_DEPTH_M = 1e-3
# Search limits for a lens's turn: tan(84°) off the axis, and just short of straight back for a fisheye.
WIDEST_RATIO, WIDEST_RAD = 10.0, 3.1
STEPS = 4096
# The inverse: Newton rounds along the radius, rounds for the tangential terms, and the accepted error.
NEWTON_ROUNDS, TANGENTIAL_ROUNDS, OFF_PX = 4, 10, 1e-3
NEWTON_STEP, LEAST_SLOPE = 1e-6, 1e-9


def project(points_camera: Array, intrinsics: CameraIntrinsics) -> tuple[Array, NDArray[np.bool_]]:
    """Return pixels (N, 2) and `is_in_image` (N,) of points (N, 3); pixels of points outside the image are meaningless.

    A pinhole sees points at least a millimetre in front of it; a fisheye also sees sideways. Raises ShapeError.
    """
    if points_camera.ndim != 2 or points_camera.shape[1] != 3:
        raise ShapeError("points_camera", points_camera.shape, "(N, 3)")
    points = points_camera.astype(np.float64)
    with np.errstate(over="ignore", invalid="ignore"):
        seen = _fisheye(points, intrinsics) if intrinsics.model == "equidistant" else _perspective(points, intrinsics)
        xy, is_seen = seen
        pixels = xy * (intrinsics.fx_px, intrinsics.fy_px) + (intrinsics.cx_px, intrinsics.cy_px)
        is_inside = (pixels >= -0.5) & (pixels < (intrinsics.width_px - 0.5, intrinsics.height_px - 0.5))
    return pixels, is_seen & is_inside.all(axis=1)


def rays_through(pixels: Array, intrinsics: CameraIntrinsics) -> Array:
    """Return the unit vectors (N, 3) of the optical frame that `project` maps to pixels (N, 2), inside or outside the
    image.

    NaN if no direction projects within `OFF_PX`, that is beyond the lens's turn. Raises ShapeError.
    """
    if pixels.ndim != 2 or pixels.shape[1] != 2:
        raise ShapeError("pixels", pixels.shape, "(N, 2)")
    focal, centre = (intrinsics.fx_px, intrinsics.fy_px), (intrinsics.cx_px, intrinsics.cy_px)
    aside = (pixels.astype(np.float64) - centre) / focal
    is_fisheye = intrinsics.model == "equidistant"
    with np.errstate(all="ignore"):
        rays = _fisheye_rays(aside, intrinsics) if is_fisheye else _perspective_rays(aside, intrinsics)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        back, is_seen = _fisheye(rays, intrinsics) if is_fisheye else _perspective(rays, intrinsics)
        off_px = np.abs((back - aside) * focal).max(axis=1)
    rays[~(is_seen & (off_px <= OFF_PX))] = np.nan
    return rays


def field_limit(intrinsics: CameraIntrinsics) -> float:
    """Return the limit off the axis up to which the lens is one-to-one: r = tan(angle), or the angle in rad for a
    fisheye.
    """
    is_fisheye = intrinsics.model == "equidistant"
    reach = np.linspace(0.0, WIDEST_RAD if is_fisheye else WIDEST_RATIO, STEPS)
    with np.errstate(all="ignore"):
        radius = reach * _radial(reach * reach, intrinsics)
        turns = np.flatnonzero(~(np.diff(radius) > 0))
    return float(reach[turns[0]]) if turns.size else float(reach[-1])


def corner_reach(intrinsics: CameraIntrinsics) -> float:
    """Return the undistorted corner farthest from the principal point, in the unit of `field_limit`.

    The centre of the first pixel is (0, 0), so the image starts half a pixel before it.
    """
    x = max(intrinsics.cx_px + 0.5, intrinsics.width_px - 0.5 - intrinsics.cx_px) / intrinsics.fx_px
    y = max(intrinsics.cy_px + 0.5, intrinsics.height_px - 0.5 - intrinsics.cy_px) / intrinsics.fy_px
    return float(np.hypot(x, y))


def is_folded(intrinsics: CameraIntrinsics) -> bool:
    """Return whether the lens turns back before the image's corner, which shows coefficients of another camera or
    model.
    """
    limit = field_limit(intrinsics)
    with np.errstate(all="ignore"):
        seen = limit * _radial(np.array([limit * limit]), intrinsics)[0]
    return not seen >= corner_reach(intrinsics)


def _perspective(points: Array, lens: CameraIntrinsics) -> tuple[Array, NDArray[np.bool_]]:
    is_before = points[:, 2] >= LEAST_DEPTH_M
    x, y = (points[:, :2] / np.where(is_before, points[:, 2], 1.0)[:, None]).T
    r2 = x * x + y * y
    is_seen = is_before & (r2 <= field_limit(lens) ** 2)
    p1, p2 = lens.distortion[2:4] if lens.distortion else (0.0, 0.0)
    radial = _radial(r2, lens)
    across = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    down = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([across, down], axis=1), is_seen


def _fisheye(points: Array, lens: CameraIntrinsics) -> tuple[Array, NDArray[np.bool_]]:
    sideways = np.hypot(points[:, 0], points[:, 1])
    angle = np.arctan2(sideways, points[:, 2])
    is_seen = (angle <= field_limit(lens)) & (np.hypot(sideways, points[:, 2]) >= LEAST_DEPTH_M)
    bent = angle * _radial(angle * angle, lens)
    ratio = np.divide(bent, sideways, out=np.zeros_like(bent), where=sideways > 0)
    return points[:, :2] * ratio[:, None], is_seen


def _fisheye_rays(aside: Array, lens: CameraIntrinsics) -> Array:
    angle = _unbent(np.hypot(*aside.T), lens)
    ratio = np.divide(np.sin(angle), np.hypot(*aside.T), out=np.ones_like(angle), where=angle > 0)
    return np.column_stack([aside * ratio[:, None], np.cos(angle)])


def _perspective_rays(aside: Array, lens: CameraIntrinsics) -> Array:
    p1, p2 = lens.distortion[2:4] if lens.distortion else (0.0, 0.0)
    bent = aside
    for _ in range(TANGENTIAL_ROUNDS):
        reach = np.hypot(*bent.T)
        ratio = np.divide(_unbent(reach, lens), reach, out=np.ones_like(reach), where=reach > 0)
        x, y = (bent * ratio[:, None]).T
        r2 = x * x + y * y
        across, down = 2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        bent = aside - np.stack([across, down], axis=1)
    return np.column_stack([x, y, np.ones_like(x)])


def _unbent(reach: Array, lens: CameraIntrinsics) -> Array:
    """Return the undistorted distance off the axis, in the unit of `field_limit`, of this distorted one; NaN beyond the
    turn.
    """
    table = np.linspace(0.0, field_limit(lens), STEPS)
    undistorted = np.interp(reach, table * _radial(table * table, lens), table, right=np.nan)
    for _ in range(NEWTON_ROUNDS):
        ahead, here = (at * _radial(at * at, lens) for at in (undistorted + NEWTON_STEP, undistorted))
        undistorted -= (here - reach) / np.maximum((ahead - here) / NEWTON_STEP, LEAST_SLOPE)
    return np.asarray(undistorted)


def _radial(squared: Array, lens: CameraIntrinsics) -> Array:
    """Return distorted over undistorted distance from the axis, for squared distances (squared angles for a
    fisheye).
    """
    d = lens.distortion
    if lens.model == "equidistant":
        return np.asarray(_series(squared, d))
    if not d:
        return np.ones_like(squared)
    over = _series(squared, (d[0], d[1], d[4]))
    return np.asarray(over / _series(squared, d[5:8]) if lens.model == "rational_polynomial" else over)


def _series(squared: Array, coefficients: tuple[float, ...]) -> Array:
    """Return 1 + c0 s + c1 s² + …"""
    total = np.zeros_like(squared)
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * squared
    return np.asarray(1.0 + total)
