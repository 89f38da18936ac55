"""Frames of a sequence: the one shown, its neighbours, and the timeline to choose another.

**Conventions.** The timeline shows the shares of T, P and N among each frame's occupied voxels. Cameras are in rig
order: the front row from left to right, then the back row.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from web.plots.time_plot import Curve, PlotSpan, PlotTick, stacked_shares, time_ticks
from web.sequence.frame_table import FrameTable
from web.sequence.recording import rig_place
from web.sequence.track import excluded_spans

STYLES = ("fill-t", "fill-p", "fill-n")


@dataclass(frozen=True)
class FrameTimeline:
    """`index` is the frame that is shown, `points` what the page's module reads, one value a frame."""

    index: int
    token: str
    frames: int
    duration_s: float
    at_s: float
    voxels: tuple[int, int, int]
    cameras: tuple[str, ...]
    curves: tuple[Curve, ...]
    spans: tuple[PlotSpan, ...]
    ticks: tuple[PlotTick, ...]
    points: Mapping[str, Any]


def timeline_of(table: FrameTable, token: str | None) -> FrameTimeline | None:
    """Return the timeline at the frame of this token, else in the middle; None without frames."""
    if not len(table):
        return None
    index = table.tokens.index(token) if token in table.tokens else len(table) // 2
    times_s, voxels = table.times_s, table.voxels
    t, p, n = (int(count) for count in voxels[index])
    return FrameTimeline(
        index,
        table.tokens[index],
        len(table),
        float(times_s[-1]),
        float(times_s[index]),
        (t, p, n),
        tuple(sorted(table.cameras, key=rig_place)),
        stacked_shares(times_s, voxels.astype(np.float64), STYLES),
        excluded_spans(table),
        time_ticks(float(times_s[-1])),
        {
            "tokens": list(table.tokens),
            "times_s": np.round(times_s, 3).tolist(),
            "voxels": voxels.tolist(),
        },
    )
