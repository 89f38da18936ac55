"""The content of the messages of each kind of sensor, over time.

**Conventions.** Samples, not every message: the captions give their number. A legend in the page distinguishes lines,
since names never enter a plot.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

from markupsafe import Markup

from stone_recordings.messages.types.cdr import NS_PER_S
from stone_recordings.report.quality.facts import CameraFacts, LidarFacts, RadarFacts, RtkFacts, middle
from stone_recordings.report.quality.markup import DrawnFigure, HtmlTable, name, number, percent
from stone_recordings.report.quality.plots import Frame, PlotLine, StripBar, series_colour, time_plot, word_strip

SensorT = TypeVar("SensorT", CameraFacts, LidarFacts, RadarFacts)


@dataclass(frozen=True)
class RtkSection:
    """The receiver's solution over time: `bars` by its words, `deviation` by its own estimate."""

    facts: RtkFacts
    bars: tuple[StripBar, ...]
    deviation: DrawnFigure


@dataclass(frozen=True)
class CamerasSection:
    """The pictures' sharpness and exposure; `legend` is by camera."""

    legend: tuple[tuple[str, str], ...]
    figures: tuple[DrawnFigure, ...]
    table: HtmlTable


def rtk_section(rtk: RtkFacts | None, duration_ns: int) -> RtkSection | None:
    if rtk is None:
        return None
    line = PlotLine(_seconds(rtk.at_ns), tuple(100 * value for value in rtk.stdev_m), "c3")
    plot = time_plot(Frame("stdev", duration_ns / NS_PER_S, "standard deviation, cm", low=0.0), [line])
    caption = Markup("Horizontal standard deviation that the receiver reports, median {} cm.").format(
        number(100 * (middle(rtk.stdev_m) or 0.0))
    )
    bars = word_strip([at_ns / max(1, duration_ns) for at_ns in rtk.at_ns], rtk.words)
    return RtkSection(rtk, bars, DrawnFigure("Reported position accuracy", plot, caption))


def cameras_section(cameras: Sequence[CameraFacts], duration_ns: int) -> CamerasSection | None:
    if not cameras:
        return None
    span_s = duration_ns / NS_PER_S
    sharp = time_plot(Frame("sharpness", span_s, "sharpness", low=0.0), _lines(cameras, lambda seen: seen.sharpness))
    bright = time_plot(
        Frame("brightness", span_s, "mean brightness, %", 0.0, 100.0),
        _lines(cameras, lambda seen: tuple(100 * value for value in seen.brightness_ratio)),
    )
    of_blur = "Variance of the Laplacian; a camera far below the others has a dirty lens or is out of focus."
    of_light = "Mean brightness of the image from black (0) to white (100); jumps are auto-exposure hunting."
    figures = (DrawnFigure("Sharpness", sharp, of_blur), DrawnFigure("Exposure", bright, of_light))
    legend = tuple((series_colour(index), camera.channel or name(camera.topic)) for index, camera in enumerate(cameras))
    return CamerasSection(legend, figures, _camera_table(cameras))


def clouds_section(
    lidars: Sequence[LidarFacts], radars: Sequence[RadarFacts], duration_ns: int
) -> tuple[DrawnFigure, ...]:
    """Return none, one or both of the figures."""
    span_s = duration_ns / NS_PER_S
    return (*([_lidars(lidars, span_s)] if lidars else []), *([_radars(radars, span_s)] if radars else []))


def _camera_table(cameras: Sequence[CameraFacts]) -> HtmlTable:
    rows = tuple(
        (
            name(camera.topic),
            f"{camera.size_px[0]} × {camera.size_px[1]}",
            str(len(camera.at_ns)),
            number(middle(camera.sharpness)),
            percent(middle(camera.brightness_ratio)),
            percent(middle(camera.dark_ratio)),
            percent(middle(camera.bright_ratio)),
        )
        for camera in cameras
    )
    columns = ("topic", "pixels", "images sampled", "sharpness", "brightness", "black", "white")
    return HtmlTable("Medians over the sampled images", columns, rows, frozenset(range(1, 7)))


def _lidars(lidars: Sequence[LidarFacts], span_s: float) -> DrawnFigure:
    lines = _lines(lidars, lambda seen: tuple(100 * value for value in seen.valid_ratio))
    plot = time_plot(Frame("valid", span_s, "points returned, %", 0.0, 102.0), lines)
    rows = tuple(
        (
            name(lidar.topic),
            number(middle(lidar.slots), 0),
            percent(middle(lidar.valid_ratio)),
            number(middle(lidar.range_m)),
        )
        for lidar in lidars
    )
    columns = ("topic", "points a sweep", "returned", "median range, m")
    table = HtmlTable("Medians over the sampled sweeps", columns, rows, frozenset({1, 2, 3}))
    caption = f"Share of a sweep's points with a return, in {len(lidars[0].at_ns)} sweeps; the sky gives none."
    return DrawnFigure("LiDAR returns", plot, caption, _legend(lidars), table)


def _radars(radars: Sequence[RadarFacts], span_s: float) -> DrawnFigure:
    lines = _lines(radars, lambda seen: tuple(map(float, seen.detections)), has_points=False)
    plot = time_plot(Frame("detections", span_s, "detections a scan", low=0.0), lines)
    rows = tuple(
        (name(radar.topic), number(middle(radar.detections), 0), str(min(radar.detections)), str(max(radar.detections)))
        for radar in radars
    )
    table = HtmlTable("Valid detections a scan", ("topic", "usual", "fewest", "most"), rows, frozenset({1, 2, 3}))
    caption = f"Valid detections in {len(radars[0].at_ns)} scans of each radar."
    return DrawnFigure("Radar detections", plot, caption, _legend(radars), table)


def _lines(
    seen: Sequence[SensorT], values: Callable[[SensorT], tuple[float, ...]], has_points: bool = True
) -> list[PlotLine]:
    return [
        PlotLine(_seconds(sensor.at_ns), values(sensor), series_colour(index), has_points)
        for index, sensor in enumerate(seen)
    ]


def _legend(seen: Sequence[SensorT]) -> tuple[tuple[str, str], ...]:
    return tuple((series_colour(index), name(sensor.topic)) for index, sensor in enumerate(seen))


def _seconds(at_ns: Sequence[int]) -> tuple[float, ...]:
    return tuple(at / NS_PER_S for at in at_ns)
