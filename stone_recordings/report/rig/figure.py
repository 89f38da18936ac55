"""The drawing of a rig as a file: from above and from the right, to scale, with each sensor's field of view.

**Conventions.** Metres in the ego frame: from above forward is up and left is left, from the right forward is right and
up is up. A sensor's own axes are short lines, x red, y green, z blue. Wedges are the fields of view of lenses; a
radar's is unknown and drawn at a usual width, dashed. Sensors farther than `FARTHEST_M` are named and not drawn.
"""

from dataclasses import dataclass
from io import BytesIO
from typing import Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle, Wedge
from numpy.typing import NDArray

from stone.errors import one_line
from stone.sensors.calibration import Calibration, SensorKind
from stone_recordings.report.previews.canvas import BACKGROUND, DOTS_PER_IN, INK, LINE, SOFT, TEXT_POINTS, dressed
from stone_recordings.report.quality.plots import drawing_style
from stone_recordings.report.rig.record import PlacedSensor, fields_of_view_deg, placed_sensors

PictureFormat = Literal["svg", "png"]
Corners = tuple[NDArray[np.float64], NDArray[np.float64]]
WIDTH_IN, HEIGHT_IN = 12.8, 7.2
COLOURS: dict[SensorKind, str] = {
    "lidar": "#f2f4ee", "camera": "#6db6f2", "radar": "#f0b45a", "ins": "#6ecb87", "imu": "#6ecb87",
}  # fmt: skip
AXIS_COLOURS = ("#ff7a6e", "#6ecb87", "#6d8cf2")
RADAR_FIELD_DEG = 110.0
FARTHEST_M = 30.0
# A sensor whose direction lies less than this in a view's plane has no wedge there.
IN_PLANE = 0.6
# Shares of the drawing's largest side: the reach of fields of view and axes, and the margin.
REACH_RATIO, AXIS_RATIO, MARGIN_RATIO = 0.3, 0.07, 0.14
LEAST_SIDE_M = 1.0
LONGEST_NAME = 28


@dataclass(frozen=True)
class RigSide:
    """One view: `right_up` (2, 3) are the directions of the ego frame that point right and up."""

    title: str
    labels: tuple[str, str]
    right_up: NDArray[np.float64]

    def flat(self, vector: NDArray[np.float64]) -> tuple[float, float]:
        right, up = (self.right_up @ vector).tolist()
        return right, up


ABOVE = RigSide("from above", ("to the right, m", "forward, m"), np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]))
RIGHT = RigSide("from the right", ("forward, m", "up, m"), np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))


def rig_figure(calibration: Calibration, is_footprint_given: bool, picture: PictureFormat = "svg") -> bytes:
    """Return SVG or PNG; equal calibrations give equal bytes."""
    placed = placed_sensors(calibration)
    near = [sensor for sensor in placed if np.abs(sensor.at_m).max() <= FARTHEST_M]
    far = [sensor.mount.name for sensor in placed if sensor not in near]
    with drawing_style("stone-rig"):
        figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), facecolor=BACKGROUND, layout="constrained")
        side_m = _side_m(calibration, near)
        for axes, side in zip(figure.subplots(1, 2), (ABOVE, RIGHT), strict=True):
            dressed(axes, side.labels, side.title)
            axes.grid(True, color=LINE, linewidth=0.5)
            axes.set_axisbelow(True)
            _body(axes, side, calibration, is_footprint_given)
            _sensors(axes, side, near, side_m)
        figure.suptitle(_plain(calibration.name), color=INK, fontsize=TEXT_POINTS + 3)
        _legend(figure, _footer(calibration, is_footprint_given, far), near)
        return _written(figure, picture)


def _side_m(calibration: Calibration, near: list[PlacedSensor]) -> float:
    """Return the largest side of the robot and its sensors."""
    half = np.array([calibration.footprint.length_m, calibration.footprint.width_m, 0.0]) / 2
    corners = [half, -half, *(sensor.at_m for sensor in near)]
    corners += [np.array(corner) for box in _near_boxes(calibration) for corner in box]
    return max(LEAST_SIDE_M, float(np.ptp(np.array(corners), axis=0).max()))


def _near_boxes(calibration: Calibration) -> list[tuple[tuple[float, float, float], tuple[float, float, float]]]:
    boxes = [(box.min_m, box.max_m) for box in calibration.self_boxes_ego]
    return [box for box in boxes if np.abs(np.array(box)).max() <= FARTHEST_M]


def _body(axes: Axes, side: RigSide, calibration: Calibration, is_given: bool) -> None:
    """Draw the footprint, on the ground from the right; the robot's own boxes; the ground; the ego origin."""
    for low, high in _near_boxes(calibration):
        _rectangle(axes, side, (np.array(low), np.array(high)), facecolor=LINE, edgecolor=LINE, alpha=0.55)
    half = np.array([calibration.footprint.length_m, calibration.footprint.width_m, 0.0]) / 2
    style = "solid" if is_given else (0, (4, 3))
    _rectangle(axes, side, (-half, half), fill=False, edgecolor=INK, linewidth=1.8, linestyle=style)
    if side is RIGHT:
        axes.axhline(0.0, color=SOFT, linewidth=0.8)
    axes.plot([0.0], [0.0], "+", color=INK, markersize=12, markeredgewidth=1.4)


def _rectangle(
    axes: Axes, side: RigSide, corners: tuple[NDArray[np.float64], NDArray[np.float64]], **how: object
) -> None:
    (x0, y0), (x1, y1) = side.flat(corners[0]), side.flat(corners[1])
    axes.add_patch(Rectangle((min(x0, x1), min(y0, y1)), abs(x1 - x0), abs(y1 - y0), **how))  # type: ignore[arg-type]


def _sensors(axes: Axes, side: RigSide, near: list[PlacedSensor], side_m: float) -> None:
    labels = list[Label]()
    for sensor in near:
        _field(axes, side, sensor, REACH_RATIO * side_m)
        _own_axes(axes, side, sensor, AXIS_RATIO * side_m)
        x, y = side.flat(sensor.at_m)
        size = 9 if sensor.mount.kind == "lidar" else 6
        axes.plot([x], [y], "o", color=COLOURS[sensor.mount.kind], markersize=size, markeredgewidth=0)
        labels.append(Label(_plain(sensor.mount.name), (x, y)))
    room_m = (REACH_RATIO + MARGIN_RATIO) * side_m
    low, high = _bounds(axes, [label.at for label in labels], room_m)
    for label, (x, y) in spread(labels, float((high - low).max())):
        axes.annotate(
            label.text, label.at, (x, y), color=INK, fontsize=TEXT_POINTS - 2, va="center", ha="center",
            arrowprops={"arrowstyle": "-", "color": SOFT, "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3},
        )  # fmt: skip


def _bounds(
    axes: Axes, places: list[tuple[float, float]], room_m: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Set a square around the sensors and the footprint on the axes, and return its corners."""
    patches = [patch.get_bbox().get_points() for patch in axes.patches if isinstance(patch, Rectangle)]
    points = np.concatenate([np.array(places).reshape(-1, 2), *patches])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half_m = (low + high) / 2, float((high - low).max()) / 2 + room_m
    low, high = middle - half_m, middle + half_m
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    return low, high


def _field(axes: Axes, side: RigSide, sensor: PlacedSensor, reach_m: float) -> None:
    """Draw the wedge of a camera's lens or a radar; nothing if it points towards the viewer or away."""
    right, up = side.flat(sensor.looks)
    if sensor.mount.kind not in ("camera", "radar") or np.hypot(right, up) < IN_PLANE:
        return
    lens = sensor.mount.intrinsics
    field_deg = RADAR_FIELD_DEG if lens is None else fields_of_view_deg(lens)[0 if side is ABOVE else 1]
    is_known = lens is not None
    heading_deg, half_deg = float(np.rad2deg(np.arctan2(up, right))), min(field_deg, 359.0) / 2
    colour = COLOURS[sensor.mount.kind]
    axes.add_patch(
        Wedge(
            side.flat(sensor.at_m), reach_m, heading_deg - half_deg, heading_deg + half_deg,
            facecolor=colour if is_known else "none", edgecolor=colour, alpha=0.22 if is_known else 0.6,
            linewidth=0.8, linestyle="solid" if is_known else (0, (4, 3)),
        )
    )  # fmt: skip


def _own_axes(axes: Axes, side: RigSide, sensor: PlacedSensor, length_m: float) -> None:
    x, y = side.flat(sensor.at_m)
    for colour, axis in zip(AXIS_COLOURS, sensor.ego_from_sensor.rotation().T, strict=True):
        right, up = side.flat(axis * length_m)
        axes.plot([x, x + right], [y, y + up], color=colour, linewidth=1.6, solid_capstyle="round")


def _footer(calibration: Calibration, is_given: bool, far: list[str]) -> str:
    footprint = calibration.footprint
    footer = f"footprint {footprint.length_m:g} x {footprint.width_m:g} m"
    footer += "" if is_given else " (the default: none is given)"
    if not calibration.self_boxes_ego:
        footer += ", no self boxes"
    return footer + (f", too far away to draw: {', '.join(map(_plain, far[:4]))}" if far else "")


def _legend(figure: Figure, footer: str, near: list[PlacedSensor]) -> None:
    kinds = [kind for kind in COLOURS if any(sensor.mount.kind == kind for sensor in near)]
    entries = [
        Line2D([], [], color=COLOURS[kind], marker="o", linestyle="none", label="LiDAR" if kind == "lidar" else kind)
        for kind in kinds
    ]
    entries += [Line2D([], [], color=colour, label=axis) for axis, colour in zip("xyz", AXIS_COLOURS, strict=True)]
    figure.legend(
        handles=entries, loc="outside lower center", ncols=len(entries), columnspacing=1.4, handlelength=1.2,
        frameon=False, labelcolor=SOFT, fontsize=TEXT_POINTS, title=footer,
    ).get_title().set_color(SOFT)  # fmt: skip


def _plain(name: str) -> str:
    """Return a foreign name in letters that the font has, cut to the available room."""
    shown = one_line(name)
    shown = shown if len(shown) <= LONGEST_NAME else shown[: LONGEST_NAME - 3] + "..."
    return shown.encode("ascii", "replace").decode()


def _written(figure: Figure, picture: PictureFormat) -> bytes:
    """Return the figure without dates and versions, which would change the bytes."""
    stream = BytesIO()
    metadata = {"Software": None} if picture == "png" else {"Date": None, "Creator": None}
    figure.savefig(stream, format=picture, dpi=DOTS_PER_IN, metadata=metadata)
    return stream.getvalue()


# Positions for the names on a drawing, so that no two overlap: in the drawing's own unit; a letter and a line are
# shares of its side. The first name gets the nearest position.


LETTER_RATIO, LINE_RATIO = 0.0165, 0.036
# Candidate positions around a point: the number of directions, and of rings that grow by a line.
DIRECTIONS, RINGS = 16, 8


@dataclass(frozen=True)
class Label:
    """A name and the point that it belongs to."""

    text: str
    at: tuple[float, float]


def spread(labels: list[Label], side: float) -> list[tuple[Label, tuple[float, float]]]:
    """Return the middle of each name's text, on a drawing `side` wide; without room, the last candidate."""
    boxes = [(*label.at, LINE_RATIO * side / 2, LINE_RATIO * side / 2) for label in labels]
    placed = list[tuple[Label, tuple[float, float]]]()
    centre = np.mean([label.at for label in labels], axis=0) if labels else np.zeros(2)
    for label in labels:
        half = (LETTER_RATIO * side * len(label.text) / 2, LINE_RATIO * side / 2)
        middle = label.at
        for right, up in _around(np.asarray(label.at) - centre):
            middle = (
                label.at[0] + right * (half[0] + LINE_RATIO * side),
                label.at[1] + up * LINE_RATIO * side,
            )
            if not any(_overlap((*middle, *half), box) for box in boxes):
                break
        boxes.append((*middle, *half))
        placed.append((label, middle))
    return placed


def _around(outward: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Return directions, nearest ring first, on each ring the outward one first; up if there is no outward
    direction.
    """
    first = np.arctan2(outward[1], outward[0]) if np.hypot(*outward) > 0 else np.pi / 2
    steps = np.arange(DIRECTIONS)
    turns = first + np.where(steps % 2, -1, 1) * ((steps + 1) // 2) * 2 * np.pi / DIRECTIONS
    return [
        (float(np.cos(turn)) * min(ring, 2), float(np.sin(turn)) * (0.7 + ring))
        for ring in range(1, RINGS + 1)
        for turn in turns
    ]


def _overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    """Return whether two boxes overlap, given as middle and half sides."""
    return abs(a[0] - b[0]) < a[2] + b[2] and abs(a[1] - b[1]) < a[3] + b[3]
