"""The history of a leaderboard: slider stops, and a curve of the best mIoU.

**Conventions.** Stops are evenly apart, whatever time passed between them, so that each can be reached; the last is
the board of now. Places are per cent of the width and of the height.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

from api.schemas.leaderboard import ChangeItem
from web.boards.axes import Axis, axis_over
from web.boards.rows import ShownBoard


@dataclass(frozen=True)
class TimelineStop:
    """A change, the page of the board since then, and where on the curve it lies; `y` is null without an entry."""

    link: str
    change: ChangeItem
    x: str
    y: str | None


@dataclass(frozen=True)
class CurveStep:
    """A straight piece of the curve."""

    x1: str
    y1: str
    x2: str
    y2: str


@dataclass(frozen=True)
class BoardTimeline:
    """`chosen` is the stop that the shown board is of."""

    stops: tuple[TimelineStop, ...]
    steps: tuple[CurveStep, ...]
    chosen: int

    @property
    def is_worth_showing(self) -> bool:
        return len(self.stops) > 1


def timeline(shown: ShownBoard, changes: Sequence[ChangeItem]) -> BoardTimeline:
    axis = axis_over(change.best_miou for change in changes)
    last = len(changes) - 1
    stops = tuple(
        TimelineStop(
            shown.link(as_of=None if place == last else _spelled(change.at)),
            change,
            f"{100 * place / max(last, 1):.2f}%",
            _height(change.best_miou, axis),
        )
        for place, change in enumerate(changes)
    )
    return BoardTimeline(stops, _steps(stops), _chosen(stops, shown.answer.as_of))


def _steps(stops: Sequence[TimelineStop]) -> tuple[CurveStep, ...]:
    """Level until the next stop, then up or down to it."""
    steps: list[CurveStep] = []
    for one, following in pairwise(stops):
        if one.y is not None:
            steps.append(CurveStep(one.x, one.y, following.x, one.y))
        if one.y is not None and following.y is not None and one.y != following.y:
            steps.append(CurveStep(following.x, one.y, following.x, following.y))
    return tuple(steps)


def _height(best: float | None, axis: Axis) -> str | None:
    return None if best is None else f"{100 - axis.place(best):.2f}%"


def _chosen(stops: Sequence[TimelineStop], as_of: datetime | None) -> int:
    if as_of is None:
        return len(stops) - 1
    return max(sum(stop.change.at <= as_of for stop in stops) - 1, 0)


def _spelled(moment: datetime) -> str:
    return moment.isoformat().replace("+00:00", "Z")
