"""What the messages of each kind of sensor hold, over time.

**Conventions.** Samples, not every message: the captions say how many. Lines are told apart by a legend in the page,
since names never enter a plot.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from services.ingest.cdr import NS_PER_S
from services.ingest.quality.facts import CameraFacts, LidarFacts, RadarFacts, RtkFacts, middle
from services.ingest.quality.markup import Table, details, figure, legend, name, number, percent, section, table, text
from services.ingest.quality.plots import Frame, Line, series_colour, time_plot
from services.ingest.quality.strips import word_strip

SensorT = TypeVar("SensorT", CameraFacts, LidarFacts, RadarFacts)


def rtk_section(rtk: RtkFacts | None, duration_ns: int) -> str:
    return section("rtk", "Position solution", _rtk(rtk, duration_ns) if rtk is not None else [])


def cameras_section(cameras: Sequence[CameraFacts], duration_ns: int) -> str:
    return section("cameras", "Cameras", _cameras(cameras, duration_ns) if cameras else [])


def clouds_section(lidars: Sequence[LidarFacts], radars: Sequence[RadarFacts], duration_ns: int) -> str:
    figures = [*_lidars(lidars, duration_ns), *_radars(radars, duration_ns)]
    return section("clouds", "LiDAR and radar", [f'<div class="grid">{"".join(figures)}</div>'] if figures else [])


def _rtk(rtk: RtkFacts, duration_ns: int) -> Iterator[str]:
    span_s = duration_ns / NS_PER_S
    told = f"RTK fixed {percent(rtk.share('fixed'))}, float {percent(rtk.share('float'))} of the time."
    strip = word_strip([at_ns / max(1, duration_ns) for at_ns in rtk.at_ns], rtk.words)
    axis = f'<div class="axis"><span>0 s</span><span>{number(span_s)} s</span></div>'
    seen = f'<p class="soft">{len(rtk.words)} messages of {name(rtk.topic)} were looked at.</p>'
    words = legend([("fixed", "RTK fixed"), ("float", "RTK float"), ("other", "anything else")])
    share = f'<p class="share">{percent(rtk.share("fixed"))}</p><p class="soft">of the time with RTK fixed</p>'
    yield f'<div class="grid">{figure("Solution over time", share + words + strip + axis, told, seen)}'
    line = Line(_seconds(rtk.at_ns), tuple(100 * value for value in rtk.stdev_m), "c3")
    plot = time_plot(Frame("stdev", span_s, "standard deviation, cm", low=0.0), [line])
    deviation = f"The receiver's own horizontal deviation, median {number(100 * (middle(rtk.stdev_m) or 0.0))} cm."
    yield f"{figure('What the receiver thinks it knows', plot, deviation)}</div>"


def _cameras(cameras: Sequence[CameraFacts], duration_ns: int) -> Iterator[str]:
    span_s = duration_ns / NS_PER_S
    yield legend([(series_colour(place), _label(camera)) for place, camera in enumerate(cameras)])
    sharp = time_plot(Frame("sharpness", span_s, "sharpness", low=0.0), _lines(cameras, lambda seen: seen.sharpness))
    bright = time_plot(
        Frame("brightness", span_s, "mean brightness, %", 0.0, 100.0),
        _lines(cameras, lambda seen: tuple(100 * value for value in seen.brightness_ratio)),
    )
    of_blur = "Variance of the Laplacian; a camera far below the others has a dirty lens or is out of focus."
    of_light = "Mean of the picture from black (0) to white (100); jumps are the exposure hunting."
    figures = figure("Sharpness", sharp, of_blur) + figure("Exposure", bright, of_light)
    yield f'<div class="grid">{figures}</div>'
    yield details("Cameras as a table", table(_camera_table(cameras)))


def _camera_table(cameras: Sequence[CameraFacts]) -> Table:
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
    columns = ("topic", "pixels", "pictures seen", "sharpness", "brightness", "black", "white")
    return Table("Medians over the pictures that were looked at", columns, rows, frozenset(range(1, 7)))


def _lidars(lidars: Sequence[LidarFacts], duration_ns: int) -> Iterator[str]:
    if not lidars:
        return
    lines = _lines(lidars, lambda seen: tuple(100 * value for value in seen.valid_ratio))
    plot = time_plot(Frame("valid", duration_ns / NS_PER_S, "points returned, %", 0.0, 102.0), lines)
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
    values = details("As a table", table(Table("Medians over the sweeps seen", columns, rows, frozenset({1, 2, 3}))))
    told = f"Share of a sweep's points that came back, in {len(lidars[0].at_ns)} sweeps; the sky never does."
    yield figure("LiDAR returns", _legend(lidars) + plot, told, values)


def _radars(radars: Sequence[RadarFacts], duration_ns: int) -> Iterator[str]:
    if not radars:
        return
    lines = _lines(radars, lambda seen: tuple(map(float, seen.detections)), has_points=False)
    plot = time_plot(Frame("detections", duration_ns / NS_PER_S, "detections a scan", low=0.0), lines)
    rows = tuple(
        (name(radar.topic), number(middle(radar.detections), 0), str(min(radar.detections)), str(max(radar.detections)))
        for radar in radars
    )
    columns = ("topic", "usual", "fewest", "most")
    values = details("As a table", table(Table("Valid detections a scan", columns, rows, frozenset({1, 2, 3}))))
    told = f"Valid detections in {len(radars[0].at_ns)} scans of each radar."
    yield figure("Radar detections", _legend(radars) + plot, told, values)


def _lines(
    seen: Sequence[SensorT], values: Callable[[SensorT], tuple[float, ...]], has_points: bool = True
) -> list[Line]:
    return [Line(_seconds(one.at_ns), values(one), series_colour(place), has_points) for place, one in enumerate(seen)]


def _legend(seen: Sequence[SensorT]) -> str:
    return legend([(series_colour(place), name(one.topic)) for place, one in enumerate(seen)])


def _label(camera: CameraFacts) -> str:
    return text(camera.channel) if camera.channel else name(camera.topic)


def _seconds(at_ns: Sequence[int]) -> tuple[float, ...]:
    return tuple(at / NS_PER_S for at in at_ns)
