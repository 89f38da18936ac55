"""`features.png`: elevation, slope and roughness of the map from above, as the paper's Fig. 5.

**Conventions.** The panels are stacked for reading on a phone. Each pixel shows the highest voxel of a column, or the
mean of several columns. The colours increase evenly in lightness (cividis, inferno, viridis), so they survive grey
printing and colour blindness; values beyond a bar's ends have the end's colour. The background is transparent. Axes are
metres in the map frame. Memory holds one tile and the picture.
"""

from dataclasses import dataclass
from math import ceil
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services.labeler.previews.map_pieces import Extent, MapPiece, Pieces, extent_of
from services.labeler.scratch import whole
from stone.geometry.lattice import indices_of
from stone.geometry.se3 import SE3
from stone.labels.voxels import VOXEL_M
from stone.surface.terrain import ELEVATION, ROUGHNESS, SLOPE

MOST_SIDE_PX = 640
DOTS_PER_IN, TEXT_POINTS, WIDTH_IN, LEAST_RATIO, MOST_RATIO = 100, 17, 9.0, 0.3, 1.6
# Margins of a panel in inches: axis labels at left and bottom, the bar's numbers, the title. They are fixed because
# matplotlib's own layout measures all texts twice, which took half of the drawing time.
LEFT_IN, RIGHT_IN, BELOW_IN, ABOVE_IN = 1.2, 1.75, 0.75, 0.5
QUANTILES = (0.02, 0.98)
STEEPEST_DEG = 60.0
INK = "#70767e"  # legible on white and on a page's dark background
TRACK_COLOUR = {ELEVATION: "#d1322f", SLOPE: "#7fd3ff", ROUGHNESS: "#d1322f"}
COLOURS = {ELEVATION: "cividis", SLOPE: "inferno", ROUGHNESS: "viridis"}
LOCAL_HEIGHT = "height above local ground, m"
HEIGHT = {"paper": "elevation h, m", "local": LOCAL_HEIGHT, "field": LOCAL_HEIGHT}
ORDER = (ELEVATION, SLOPE, ROUGHNESS)


@dataclass(frozen=True, eq=False)
class Rasters:
    """`values` (3, H, W), north up, NaN without surface; `bounds_m` west, east, south, north."""

    values: NDArray[np.float64]
    bounds_m: tuple[float, float, float, float]


def write_feature_maps(pieces: Pieces, map_from_ego: SE3, path: Path, profile: str = "paper") -> None:
    """Draw the three panels with the track of the poses (P,).

    `profile` determines the first feature. A map without voxels gives empty panels.
    """
    figure = feature_figure(rasters_of(pieces), map_from_ego.translation_m, profile)
    with whole(path) as staging:
        figure.savefig(staging, format="png", dpi=DOTS_PER_IN, metadata={"Software": None})


def rasters_of(pieces: Pieces) -> Rasters:
    """Return the features from above, at most `MOST_SIDE_PX` a side."""
    extent = extent_of(pieces)
    if extent is None:
        return Rasters(np.full((3, 1, 1), np.nan), (0.0, VOXEL_M, 0.0, VOXEL_M))
    wide, high = (extent.high - extent.low)[:2]
    columns_per_px = ceil(max(wide, high) / MOST_SIDE_PX)
    shape = (3, ceil(high / columns_per_px), ceil(wide / columns_per_px))
    sums, counts = np.zeros(shape), np.zeros(shape[1:])
    for load in pieces:
        _add(load(), extent, columns_per_px, (sums, counts))
    values = np.divide(sums, counts, out=np.full(shape, np.nan), where=counts > 0)
    west, south = extent.low_m()[:2]
    side_m = columns_per_px * VOXEL_M
    bounds_m = (float(west), float(west + shape[2] * side_m), float(south), float(south + shape[1] * side_m))
    return Rasters(values[:, ::-1], bounds_m)


def _add(
    piece: MapPiece, extent: Extent, columns_per_px: int, into: tuple[NDArray[np.float64], NDArray[np.float64]]
) -> None:
    if len(piece.keys) == 0:
        return
    indices = indices_of(piece.keys)
    last = np.append((np.diff(indices[:, :2], axis=0) != 0).any(axis=1), True)  # keys sort z lowest
    pixel = (indices[last, :2] - extent.low[:2]) // columns_per_px
    sums, counts = into
    np.add.at(counts, (pixel[:, 1], pixel[:, 0]), 1)
    for feature in ORDER:
        np.add.at(sums[feature], (pixel[:, 1], pixel[:, 0]), piece.features[last, feature])


def feature_figure(rasters: Rasters, track_map: NDArray[np.float64], profile: str) -> Figure:
    """Return the panels with their bars; `track_map` is (P, 3)."""
    west, east, south, north = rasters.bounds_m
    ratio = min(max((north - south) / (east - west), LEAST_RATIO), MOST_RATIO)
    wide_in = WIDTH_IN - LEFT_IN - RIGHT_IN
    panel_in = BELOW_IN + wide_in * ratio + ABOVE_IN
    height_in = len(ORDER) * panel_in
    figure = Figure(figsize=(WIDTH_IN, height_in), facecolor="none")
    words = {ELEVATION: HEIGHT[profile], SLOPE: "slope θ, °", ROUGHNESS: "roughness r, ln m²"}
    for number, feature in enumerate(ORDER, 1):
        bottom_in = height_in - number * panel_in + BELOW_IN
        rectangle = (LEFT_IN / WIDTH_IN, bottom_in / height_in, wide_in / WIDTH_IN, wide_in * ratio / height_in)
        axes = figure.add_axes(rectangle)
        _panel(figure, axes, rasters, feature)
        axes.set_title(words[feature], color=INK, fontsize=TEXT_POINTS + 3, loc="left")
        axes.plot(track_map[:, 0], track_map[:, 1], color=TRACK_COLOUR[feature], linewidth=2.0)
        axes.set_xlim(west, east)
        axes.set_ylim(south, north)
    return figure


def _panel(figure: Figure, axes: Axes, rasters: Rasters, feature: int) -> None:
    values = rasters.values[feature]
    shown = np.degrees(values) if feature == SLOPE else values
    least, most = limits_of(shown, feature)
    picture = axes.imshow(
        shown, cmap=COLOURS[feature], vmin=least, vmax=most, extent=rasters.bounds_m, interpolation="nearest"
    )
    beside = axes.inset_axes((1.03, 0.0, 0.045, 1.0))
    bar = figure.colorbar(picture, cax=beside, extend="max" if feature == SLOPE else "both", extendfrac=0.03)
    for part in (axes, bar.ax):
        part.tick_params(colors=INK, labelsize=TEXT_POINTS, length=3)
    axes.set_facecolor("none")
    for spine in (*axes.spines.values(), *bar.ax.spines.values(), bar.outline):
        spine.set_edgecolor(INK)
    axes.set_aspect("equal", adjustable="box")
    axes.locator_params(nbins=6)
    axes.set_xlabel("east, m", color=INK, fontsize=TEXT_POINTS)
    axes.set_ylabel("north, m", color=INK, fontsize=TEXT_POINTS)


def limits_of(values: NDArray[np.float64], feature: int) -> tuple[float, float]:
    """Return the ends of the bar: fixed for the slope, otherwise quantiles of the values."""
    if feature == SLOPE:
        return 0.0, STEEPEST_DEG
    finite = values[np.isfinite(values)]
    if finite.size == 0:
        return 0.0, 1.0
    least, most = (float(q) for q in np.quantile(finite, QUANTILES))
    return (least, most) if most > least else (least - 0.5, most + 0.5)
