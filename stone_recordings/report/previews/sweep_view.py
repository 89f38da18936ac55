"""One sweep from above, coloured by height, with rings of distance, to check the LiDAR's view.

**Conventions.** LiDAR frame in metres, x to the right and y up as in the sensor's frame (its mount is unknown here),
the sensor in the middle. Height is z relative to the median of the points within `NEAR_M`, which is near the ground.
PNG.
"""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Circle
from numpy.typing import NDArray

from stone.errors import StoneError
from stone_recordings.bags.bag import Bag
from stone_recordings.messages.pointcloud2 import lidar_points
from stone_recordings.messages.sweep_clouds import cloud_at
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.previews.canvas import (
    BACKGROUND,
    INK,
    LINE,
    SOFT,
    TEXT_POINTS,
    dressed,
    png,
    square_figure,
)
from stone_recordings.report.quality.plots import drawing_style
from stone_recordings.report.quality.sampling import of_role

RADII_M = (10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 120.0, 200.0)
SHOWN_SHARE = 0.93
NEAR_M, LAST_M = 10.0, 300.0
HEIGHT_SHARES, LEAST_SPAN_M = (0.02, 0.97), 3.0
RASTER_PX = 720
# Light at both ends, unlike most maps: the sheet is dark.
COLOURS = ("#4f7fe0", "#35bccb", "#74d47e", "#f4d75e", "#f59447", "#f2607c")
PLATE = {"boxstyle": "round,pad=0.2", "facecolor": BACKGROUND, "edgecolor": "none", "alpha": 0.75}
SPLAT = ((0, 1), (1, 0), (1, 1))
PLACES = (0.5, 0.25, 0.75, 0.0)


def sweep_view(bag: Bag, inspection: Inspection) -> bytes | None:
    """Return the view; None if no sweep can be read or none has points."""
    points_lidar = _sweep(bag, inspection)
    if points_lidar is None:
        return None
    distances_m = np.hypot(points_lidar[:, 0], points_lidar[:, 1])
    reach_m = float(np.quantile(distances_m, SHOWN_SHARE))
    radius_m = next((radius for radius in RADII_M if radius >= reach_m), RADII_M[-1])
    is_near = distances_m <= NEAR_M
    ground_m = float(np.median(points_lidar[is_near, 2])) if is_near.any() else 0.0
    raster = from_above(points_lidar - np.array([0, 0, ground_m], np.float32), radius_m)
    with drawing_style():
        figure = square_figure()
        _draw(figure, raster, radius_m, f"{len(points_lidar):,} points".replace(",", " "))
        return png(figure)


def from_above(points: NDArray[np.float32], radius_m: float) -> NDArray[np.float32]:
    """Return the highest z in each pixel of (RASTER_PX, RASTER_PX) over [−radius, radius)², y upwards; NaN without
    points.
    """
    raster = np.full((RASTER_PX, RASTER_PX), np.nan, np.float32)
    columns, rows = np.floor((points[:, :2].astype(np.float64) + radius_m) * (RASTER_PX / (2 * radius_m))).T
    is_inside = (columns >= 0) & (columns < RASTER_PX) & (rows >= 0) & (rows < RASTER_PX)
    order = np.flatnonzero(is_inside)[
        np.argsort(points[is_inside, 2], kind="stable")
    ]  # the last point of a pixel stays
    row, column, height = rows[order].astype(np.intp), columns[order].astype(np.intp), points[order, 2]
    for down, right in SPLAT:
        raster[np.minimum(row + down, RASTER_PX - 1), np.minimum(column + right, RASTER_PX - 1)] = height
    raster[row, column] = height
    return raster


def _sweep(bag: Bag, inspection: Inspection) -> NDArray[np.float32] | None:
    """Return the points (N, 3) of the first LiDAR's sweep in the middle, else of another readable sweep."""
    for topic in of_role(inspection, "lidar")[:1]:
        for share in PLACES:
            try:
                cloud = cloud_at(bag, topic.name, int(share * (topic.count - 1)))
                points_lidar = lidar_points(cloud).points_lidar
            except StoneError:
                continue  # the quality report names it
            kept = points_lidar[(np.abs(points_lidar) < LAST_M).all(axis=1)]
            if len(kept):
                return kept
    return None


def _draw(figure: Figure, raster: NDArray[np.float32], radius_m: float, title: str) -> None:
    axes = figure.add_subplot()
    dressed(axes, ("", ""), title)
    axes.set_xticks([])
    axes.set_yticks([])
    extent = (-radius_m, radius_m, -radius_m, radius_m)
    colours = LinearSegmentedColormap.from_list("height", COLOURS)
    image = axes.imshow(raster, colours, _heights(raster), origin="lower", extent=extent, interpolation="nearest")
    _rings(axes, radius_m)
    _arrows(axes, radius_m * 0.09)
    axes.set_xlim(-radius_m, radius_m)
    axes.set_ylim(-radius_m, radius_m)
    bar = figure.colorbar(image, ax=axes, location="bottom", shrink=0.7, aspect=40, pad=0.01)
    bar.set_label("height over the ground nearby, m", color=SOFT, fontsize=TEXT_POINTS)
    bar.ax.tick_params(colors=SOFT, labelsize=TEXT_POINTS, length=0)
    bar.outline.set_visible(False)


def _heights(raster: NDArray[np.float32]) -> Normalize:
    """Return the colour range: nearly all pixels, at least `LEAST_SPAN_M`, in whole halves of a metre."""
    low_m, high_m = np.nanquantile(raster, HEIGHT_SHARES) if not np.isnan(raster).all() else (0.0, 0.0)
    low_m = float(np.floor(low_m * 2) / 2)
    return Normalize(low_m, max(float(np.ceil(high_m * 2) / 2), low_m + LEAST_SPAN_M), clip=True)


def _arrows(axes: Axes, length: float) -> None:
    """Draw the sensor's axes from the middle."""
    for end, letter in (((length, 0.0), "x"), ((0.0, length), "y")):
        style = {"arrowstyle": "-|>", "color": INK, "linewidth": 2.2, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", end, (0, 0), arrowprops=style)
        tip = (end[0] * 1.35, end[1] * 1.35)
        axes.annotate(letter, tip, color=INK, fontsize=TEXT_POINTS, ha="center", va="center", bbox=PLATE)


def _rings(axes: Axes, radius_m: float) -> None:
    step_m = next(step for step in (5.0, 10.0, 20.0, 50.0) if radius_m / step <= 4)
    for distance_m in np.arange(step_m, radius_m * 1.001, step_m):
        axes.add_patch(Circle((0, 0), float(distance_m), fill=False, color=LINE, linewidth=1.0))
        label = (0.7071 * float(distance_m), -0.7071 * float(distance_m))
        axes.annotate(
            f"{distance_m:.0f} m",
            label,
            color=INK,
            fontsize=TEXT_POINTS - 1,
            ha="center",
            va="center",
            bbox=PLATE,
        )
