"""One sheet per frame: three cameras above, three below, and the labels from above and in perspective between them.

The arrangement follows the paper's Fig. 6. A camera without a picture leaves a blank with the reason.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageOps

from services.domain.viewer.frame_picture import plan
from services.labeler.exports.source import LabelledSequence
from services.labeler.previews.lettering import chip, font, legend
from services.labeler.previews.picture_opening import opened
from services.labeler.previews.render import Boxes, Camera, Canvas, Colour, beads, solid_boxes, voxel_boxes
from stone.geometry.se3 import SE3
from stone.labels.class_colours import INK, PAPER, TRACK
from stone.labels.grid import Grid
from stone.sensors.calibration import Box, Footprint
from stone.sensors.samples import CameraSample
from stone.sensors.sequence import Sequence
from stone_base.label_grid import PAPER as GRID
from stone_base.label_grid import LabelGrid

ABOVE = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT")
BELOW = ("CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
WIDTH_PX, GAP_PX, PLAN_PX, BAR_PX = 1280, 8, 456, 84
CAMERA_PX = (WIDTH_PX - 4 * GAP_PX) // 3
USUAL_RATIO, LEAST_RATIO, MOST_RATIO = 0.625, 0.4, 0.75
LABEL_PX, BAR_TEXT_PX = 22, 25
BLANK, SOFT = (214, 214, 210), (96, 102, 110)


@dataclass(frozen=True, eq=False)
class FramePictures:
    """The labels from above and in perspective, and the sheet that shows both among the cameras."""

    plan: Image.Image
    oblique: Image.Image
    sheet: Image.Image


@dataclass(frozen=True)
class _Rectangle:
    """Left, top, width and height, pixels."""

    x: int
    y: int
    width: int
    height: int


def frame_pictures(source: LabelledSequence, index: int) -> FramePictures:
    """Return the pictures of frame `index`, `oblique.WIDTH_PX` and `bev.SIDE_PX` wide, and the sheet `WIDTH_PX` wide.

    Raises IndexError, and what the source raises.
    """
    grids, around = source.grids(index), surroundings_of(source.sequence, index, source.grid)
    return FramePictures(bev(grids, around), oblique(grids, around), frame_sheet(source, index))


def frame_sheet(source: LabelledSequence, index: int, ratio: float | None = None) -> Image.Image:
    """Return the sheet; `ratio` is the height to width of the camera cells, by default that of the first picture."""
    samples = {channel: source.samples.camera(channel, index) for channel in (*ABOVE, *BELOW)}
    ratio = ratio or cell_ratio(samples.values())
    high_px = _camera_height_px(ratio)
    top_px, low_px = 2 * GAP_PX + high_px, 3 * GAP_PX + high_px + PLAN_PX
    sheet = Image.new("RGB", sheet_size(ratio), PAPER)
    for row, channels in ((GAP_PX, ABOVE), (low_px, BELOW)):
        for column, channel in enumerate(channels):
            rectangle = _Rectangle(GAP_PX + column * (CAMERA_PX + GAP_PX), row, CAMERA_PX, high_px)
            _place_camera(sheet, rectangle, channel, samples[channel])
    grids, around = source.grids(index), surroundings_of(source.sequence, index, source.grid)
    size_px = (WIDTH_PX - 3 * GAP_PX - PLAN_PX, PLAN_PX)
    sheet.paste(bev(grids, around, PLAN_PX), (GAP_PX, top_px))
    sheet.paste(oblique(grids, around, size_px), (2 * GAP_PX + PLAN_PX, top_px))
    _write_bar(sheet, source, index)
    return sheet


def sheet_size(ratio: float) -> tuple[int, int]:
    """Return width and height of a sheet with camera cells of this ratio; both even, as films require."""
    return WIDTH_PX, 3 * GAP_PX + 2 * _camera_height_px(ratio) + PLAN_PX + BAR_PX


def _camera_height_px(ratio: float) -> int:
    return round(CAMERA_PX * ratio) // 2 * 2


def cell_ratio(samples: Iterable[CameraSample | None]) -> float:
    """Return the height to width of the first picture, within limits."""
    ratio = next((sample.height_px / sample.width_px for sample in samples if sample is not None), USUAL_RATIO)
    return min(max(ratio, LEAST_RATIO), MOST_RATIO)


def _place_camera(sheet: Image.Image, rectangle: _Rectangle, channel: str, sample: CameraSample | None) -> None:
    picture = opened(sample, (rectangle.width, rectangle.height))
    cell = Image.new("RGB", (rectangle.width, rectangle.height), BLANK)
    if isinstance(picture, Image.Image):
        picture = ImageOps.contain(picture, cell.size, Image.Resampling.BILINEAR)
        cell.paste(picture, ((cell.width - picture.width) // 2, (cell.height - picture.height) // 2))
    else:
        pen = ImageDraw.Draw(cell)
        pen.text((cell.width / 2, cell.height / 2), picture, SOFT, font(LABEL_PX), anchor="mm")
    chip(cell, (6, cell.height - 6), channel, LABEL_PX)
    sheet.paste(cell, (rectangle.x, rectangle.y))


def _write_bar(sheet: Image.Image, source: LabelledSequence, index: int) -> None:
    """Draw frame number, time and sequence above the legend."""
    sequence = source.sequence
    stamps_ns = sequence.frames.stamps_ns
    since_s = (int(stamps_ns[index]) - int(stamps_ns[0])) / 1e9
    utc = datetime.fromtimestamp(int(stamps_ns[index]) // 10**9, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
    left, top = GAP_PX + 2, sheet.height - BAR_PX
    pen = ImageDraw.Draw(sheet)
    words = f"frame {index + 1} / {len(stamps_ns)}   {since_s:.1f} s   {utc}"
    pen.text((left, top + BAR_PX * 0.27), words, INK, font(BAR_TEXT_PX), anchor="lm")
    room_px = WIDTH_PX - 2 * left - pen.textlength(words, font(BAR_TEXT_PX)) - 2 * BAR_TEXT_PX
    name = _fit_name(sequence.name, room_px, pen)
    pen.text((WIDTH_PX - left, top + BAR_PX * 0.27), name, SOFT, font(BAR_TEXT_PX), anchor="rm")
    legend(sheet, (left, top + BAR_PX * 0.73), BAR_TEXT_PX)


def _fit_name(name: str, room_px: float, pen: ImageDraw.ImageDraw) -> str:
    """Return the name, shortened to the available width."""
    while name and pen.textlength(name, font(BAR_TEXT_PX)) > room_px:
        name = name[:-2].rstrip("…") + "…" if len(name) > 2 else ""
    return name


def _nowhere() -> NDArray[np.float64]:
    return np.zeros((0, 3))


@dataclass(frozen=True, eq=False)
class Surroundings:
    """`track_ego` (P, 3): the whole run's poses in this frame's axes, in order; most are outside the `grid`."""

    track_ego: NDArray[np.float64] = field(default_factory=_nowhere)
    footprint: Footprint = field(default_factory=Footprint)
    grid: LabelGrid = GRID


ALONE = Surroundings()


def surroundings_of(sequence: Sequence, index: int, grid: LabelGrid = GRID) -> Surroundings:
    """Return the surroundings of frame `index`, labelled at this grid."""
    poses = sequence.frames.map_from_ego
    ego_from_map: SE3 = poses[index].inverse()
    return Surroundings(ego_from_map @ poses.translation_m, sequence.calibration.footprint, grid)


def runs_inside(track_ego: NDArray[np.float64], grid: LabelGrid = GRID) -> list[NDArray[np.float64]]:
    """Return the sections (P', 3) of a track that are within the grid in plan."""
    low, high = np.array(grid.min_m[:2]), np.array(grid.max_m[:2])
    inside = ((track_ego[:, :2] >= low) & (track_ego[:, :2] < high)).all(axis=1)
    cuts = np.flatnonzero(np.diff(inside.astype(np.int8))) + 1
    pieces = np.split(track_ego, cuts)
    return [piece for piece in pieces if len(piece) and _is_inside(piece[0], low, high)]


def _is_inside(point: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    return bool(((point[:2] >= low) & (point[:2] < high)).all())


# The label grid of one frame from above: forward is up, left is left. Each pixel shows the highest labelled voxel of
# its column, shaded by the relief; grey columns are unobserved, white columns observed free. Rings are 10 and 20 m from
# the robot.


SIDE_PX = 800
RING = (120, 124, 130)
RINGS_M = (10, 20)
FINER = 2


def bev(grids: Mapping[str, Grid], around: Surroundings = ALONE, side_px: int = SIDE_PX) -> Image.Image:
    """Return a picture of `semantics`, its longer side `side_px`; with `mask_lidar`, unobserved columns are grey."""
    fine_px = side_px * FINER
    frame = _PlanFrame(around.grid, fine_px)
    image = Image.fromarray(plan(grids["semantics"], grids.get("mask_lidar"))).resize(
        frame.size_px, Image.Resampling.NEAREST
    )
    pen = ImageDraw.Draw(image)
    for radius_m in RINGS_M:
        _ring(pen, radius_m, frame)
    for run in runs_inside(around.track_ego, around.grid):
        width_px = max(2, round(fine_px / 220))
        for colour, wider_px in ((PAPER, 2 * FINER), (TRACK, 0)):
            pen.line(frame.pixels(run), fill=colour, width=width_px + wider_px, joint="curve")
    x, y = around.footprint.length_m / 2, around.footprint.width_m / 2
    outline = np.array([(x, y), (x, -y), (-x, -y), (-x, y)])
    pen.polygon(frame.pixels(outline), fill=INK)
    pen.polygon(frame.pixels(np.array([(x, 0.0), (0.1, -0.6 * y), (0.1, 0.6 * y)])), fill=(245, 245, 245))
    return image.reduce(FINER)


@dataclass(frozen=True)
class _PlanFrame:
    """A grid from above in a picture whose longer side has `side_px`."""

    grid: LabelGrid
    side_px: int

    @property
    def px_per_m(self) -> float:
        return self.side_px / (max(self.grid.shape[:2]) * self.grid.voxel_m)

    @property
    def size_px(self) -> tuple[int, int]:
        """Width and height: y runs across, x up."""
        x, y = (round(sides * self.grid.voxel_m * self.px_per_m) for sides in self.grid.shape[:2])
        return y, x

    def pixels(self, points_ego: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Return the positions of points (P, 2 or 3) in the picture."""
        high_x, high_y = self.grid.max_m[:2]
        across, down = (high_y - points_ego[:, 1]) * self.px_per_m, (high_x - points_ego[:, 0]) * self.px_per_m
        return list(zip(across.tolist(), down.tolist(), strict=True))


def _ring(pen: ImageDraw.ImageDraw, radius_m: int, frame: _PlanFrame) -> None:
    (x, y), side_px = frame.pixels(np.zeros((1, 2)))[0], frame.side_px
    radius = radius_m * frame.px_per_m
    pen.ellipse((x - radius, y - radius, x + radius, y + radius), outline=RING, width=max(2, side_px // 500))
    size, aside = max(20, side_px // 36), radius * 0.7071
    halo = {"stroke_width": size // 7, "stroke_fill": PAPER}
    pen.text((x + aside, y - aside), f"{radius_m} m", INK, font(size), anchor="mm", **halo)  # type: ignore[arg-type]


OBLIQUE_WIDTH_PX, HEIGHT_PX = 800, 480
CAMERA = Camera(np.array([-38.0, 12.0, 25.0]), np.array([-2.0, -0.6, -3.0]), np.deg2rad(60.0))
ROBOT: Colour = (52, 58, 68)
BEAD_M, BEADS_APART_M, BEAD_FOOT_M, BEAD_TOP_M = 0.14, 0.1, -0.1, 0.32


def oblique(
    grids: Mapping[str, NDArray[np.uint8]],
    around: Surroundings = ALONE,
    size_px: tuple[int, int] = (OBLIQUE_WIDTH_PX, HEIGHT_PX),
) -> Image.Image:
    """Return the picture of `grids["semantics"]` with the robot and its track; unlabelled voxels are not drawn."""
    grid, wider = around.grid, around.grid.max_m[0] / GRID.max_m[0]
    canvas = Canvas(replace(CAMERA, eye_m=CAMERA.eye_m * wider, target_m=CAMERA.target_m * wider), *size_px)
    canvas.add(voxel_boxes(np.ascontiguousarray(grids["semantics"]), np.array(grid.min_m), grid.voxel_m))
    for run in runs_inside(around.track_ego, grid):
        canvas.add(track_boxes(run))
    for boxes in robot_boxes(around.footprint):
        canvas.add(boxes)
    return canvas.image()


def track_boxes(track: NDArray[np.float64]) -> Boxes:
    """Return beads along the track (P, 3) that form a line and stand out of their voxels."""
    steps_m = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    at_m = np.arange(0.0, along_m[-1] + BEADS_APART_M, BEADS_APART_M)
    centre = np.stack([np.interp(at_m, along_m, track[:, axis]) for axis in range(3)], axis=1)
    half = np.array([BEAD_M / 2, BEAD_M / 2, 0.0])
    low, high = centre - half + (0, 0, BEAD_FOOT_M), centre + half + (0, 0, BEAD_TOP_M)
    return beads(np.concatenate([low, high], axis=1).astype(np.float32), TRACK)


def robot_boxes(footprint: Footprint) -> list[Boxes]:
    """Return a body on the footprint, a mast, and a sensor head at the front that shows the direction."""
    x, y = footprint.length_m / 2, footprint.width_m / 2
    body = solid_boxes([Box((-x, -y, 0.15), (x, y, 0.6)), Box((-0.08, -0.08, 0.6), (0.08, 0.08, 1.1))], ROBOT)
    nose = solid_boxes([Box((x - 0.25, -y, 0.6), (x, y, 0.75))], (245, 245, 245))
    return [body, nose, solid_boxes([Box((-0.16, -0.16, 1.1), (0.16, 0.16, 1.35))], INK)]
