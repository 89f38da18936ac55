"""The track on a plot: north up, its length in the title, coloured by the accuracy that the receiver reports.

**Conventions.** Metres, equal scales. Start is a ring, end a square.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pymap3d
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from stone_recordings.bags.bag import Bag, RawMessage, Topic
from stone_recordings.messages.gnss import GNSS_TYPES, decode_gnss
from stone_recordings.messages.odometry import decode_odometry
from stone_recordings.messages.tf import decode_transforms
from stone_recordings.poses.sources import FIXED_FRAMES
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.previews.canvas import INK, LINE, SOFT, TEXT_POINTS, dressed, png, square_figure
from stone_recordings.report.quality.facts import RtkWord
from stone_recordings.report.quality.plots import drawing_style
from stone_recordings.report.quality.report import BESTPOS, INSPVAX, WORD_OF_TYPE, decode_solution
from stone_recordings.report.quality.sampling import TINY, SampledMessages, TopicSampling, of_role, sample
from stone_recordings.topics.roles import Role

# The robot's track from a few hundred positions: the first of INS, odometry, satellite fixes and TF with two positions.
# Metres: east and north of the first usable position for sources in latitudes, else the source's own fixed frame.
# Nothing is smoothed; positions farther than `LAST_M` from the middle of the others along either axis are dropped.


SOURCE_ROLES: tuple[Role, ...] = ("ins", "odometry", "gnss", "tf")
LAST_M = 20_000.0


@dataclass(frozen=True, eq=False)
class RecordedTrack:
    """`points_m` (N, 2), N at least 2; `words` (N) if the source reports the quality of its positions, else ()."""

    source: str
    points_m: NDArray[np.float64]
    words: tuple[RtkWord, ...]
    is_geodetic: bool


@dataclass(frozen=True)
class _Position:
    """Latitude, longitude in degrees and 0, or x, y in metres; `group` is the pair of frames of the position."""

    first: float
    second: float
    word: RtkWord | None = None
    group: tuple[str, str] = ("", "")


Reader = Callable[[Topic, RawMessage], list[_Position]]


def track_of(bag: Bag, inspection: Inspection, sampled: SampledMessages | None = None) -> RecordedTrack | None:
    """Return the track; None with fewer than two positions. Messages that were `sampled` before are not read again."""
    messages = sampled or SampledMessages(bag)
    for role in SOURCE_ROLES:
        for topic in of_role(inspection, role):
            if topic.type in READERS and (track := _track(messages, topic)) is not None:
                return track
    return None


def _track(messages: SampledMessages, topic: Topic) -> RecordedTrack | None:
    read, is_geodetic = READERS[topic.type]
    seen: list[_Position] = []
    sample(
        messages.bag,
        [TopicSampling(topic, lambda at_ns, payload: seen.extend(read(topic, RawMessage(at_ns, 0, payload))), TINY)],
        messages,
    )
    usable = [position for position in _of_one_group(seen) if _is_place(position, is_geodetic)]
    if len(usable) < 2:
        return None
    values = np.array([(position.first, position.second) for position in usable], np.float64)
    points_m = _east_north_m(values) if is_geodetic else values
    is_near = np.max(np.abs(points_m - np.median(points_m, axis=0)), axis=1) <= LAST_M
    if is_near.sum() < 2:
        return None
    words = tuple(
        position.word for position, kept in zip(usable, is_near, strict=True) if kept and position.word is not None
    )
    has_words = len(words) == int(is_near.sum())
    return RecordedTrack(topic.type.rpartition("/")[2], points_m[is_near], words if has_words else (), is_geodetic)


def _is_place(position: _Position, is_geodetic: bool) -> bool:
    """Return whether a position is finite and on Earth; receivers write 0, 0 before their first fix."""
    if not np.isfinite([position.first, position.second]).all():
        return False
    return not is_geodetic or (
        abs(position.first) <= 90 and abs(position.second) <= 360 and (position.first, position.second) != (0, 0)
    )


def _of_one_group(seen: list[_Position]) -> list[_Position]:
    """Return the positions of the most frequent pair of frames."""
    groups = [position.group for position in seen]
    chosen = max(sorted(set(groups)), key=groups.count, default=("", ""))
    return [position for position in seen if position.group == chosen]


def _east_north_m(degrees: NDArray[np.float64]) -> NDArray[np.float64]:
    east, north, _up = pymap3d.geodetic2enu(degrees[:, 0], degrees[:, 1], 0.0, degrees[0, 0], degrees[0, 1], 0.0)
    return np.stack([east, north], axis=1)


def _solution(topic: Topic, message: RawMessage) -> list[_Position]:
    samples = decode_solution(topic, message)
    word = None if samples.pos_type is None else WORD_OF_TYPE.get(int(samples.pos_type[0]), "other")
    return [_Position(float(samples.latitude_deg[0]), float(samples.longitude_deg[0]), word)]


def _fix(topic: Topic, message: RawMessage) -> list[_Position]:
    samples = decode_gnss(topic.type, [message], topic.schema)
    if not samples.is_fixed[0]:
        return []
    return [_Position(float(samples.latitude_deg[0]), float(samples.longitude_deg[0]))]


def _odometry(_topic: Topic, message: RawMessage) -> list[_Position]:
    samples = decode_odometry([message])
    x_m, y_m, _z_m = samples.parent_from_child.translation_m[0].tolist()
    return [_Position(x_m, y_m)]


def _transforms(_topic: Topic, message: RawMessage) -> list[_Position]:
    moving = [pair for pair in decode_transforms([message]) if pair.parent.strip("/") in FIXED_FRAMES]
    return [
        _Position(float(x_m), float(y_m), None, (pair.parent, pair.child))
        for pair in moving
        for x_m, y_m in pair.parent_from_child.translation_m[:1, :2]
    ]


# The reader of each type, and whether it gives latitude and longitude.
READERS: dict[str, tuple[Reader, bool]] = {
    **dict.fromkeys(("novatel_oem7_msgs/msg/INSPVA", INSPVAX, BESTPOS), (_solution, True)),
    **dict.fromkeys(GNSS_TYPES, (_fix, True)),
    "nav_msgs/msg/Odometry": (_odometry, False),
    "tf2_msgs/msg/TFMessage": (_transforms, False),
}


COLOUR_OF_WORD = {"fixed": "#6ecb87", "float": "#f0b45a", "other": "#ff7a6e"}
LABEL_OF_WORD = {"fixed": "RTK fixed", "float": "RTK float", "other": "neither"}
UNKNOWN_COLOUR = "#6db6f2"
MARGIN_RATIO, LEAST_SPAN_M = 0.08, 2.0


def track_view(track: RecordedTrack) -> bytes:
    """Return the plot as PNG."""
    with drawing_style():
        figure = square_figure()
        axes = figure.add_subplot()
        steps_m = np.linalg.norm(np.diff(track.points_m, axis=0), axis=1)
        dressed(axes, _labels(track), f"{steps_m.sum():,.0f} m by {track.source}".replace(",", " "))
        axes.grid(True, color=LINE, linewidth=0.6)
        axes.set_axisbelow(True)
        _bounded(axes, track)
        _line(axes, track)
        _legend(figure, track)
        return png(figure)


def _labels(track: RecordedTrack) -> tuple[str, str]:
    return ("east of the start, m", "north of the start, m") if track.is_geodetic else ("x, m", "y, m")


def _bounded(axes: Axes, track: RecordedTrack) -> None:
    """Set a square around the track, so that a straight drive is not a hairline."""
    low, high = track.points_m.min(axis=0), track.points_m.max(axis=0)
    middle = (low + high) / 2
    half = max(float((high - low).max()), LEAST_SPAN_M) * (0.5 + MARGIN_RATIO)
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def _line(axes: Axes, track: RecordedTrack) -> None:
    segments = np.stack([track.points_m[:-1], track.points_m[1:]], axis=1)
    colours = [COLOUR_OF_WORD[word] for word in track.words[1:]] or UNKNOWN_COLOUR
    axes.add_collection(LineCollection(list(segments), colors=colours, linewidths=3, capstyle="round"))
    start, end = track.points_m[0], track.points_m[-1]
    axes.plot([start[0]], [start[1]], "o", color=INK, markersize=10, markerfacecolor="none", markeredgewidth=2)
    axes.plot([end[0]], [end[1]], "s", color=INK, markersize=8)


def _legend(figure: Figure, track: RecordedTrack) -> None:
    """Draw the legend below the plot, clear of the track."""
    entries = [
        Line2D([], [], color=INK, marker="o", markerfacecolor="none", linestyle="none", label="start"),
        Line2D([], [], color=INK, marker="s", linestyle="none", label="end"),
    ]
    entries += [
        Line2D([], [], color=colour, linewidth=3, label=LABEL_OF_WORD[word])
        for word, colour in COLOUR_OF_WORD.items()
        if word in track.words
    ]
    figure.legend(
        handles=entries,
        loc="outside lower center",
        ncols=len(entries),
        columnspacing=1.2,
        handlelength=1.4,
        frameon=False,
        labelcolor=SOFT,
        fontsize=TEXT_POINTS,
    )
