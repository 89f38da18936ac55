"""Gantt chart of a run: one row per stage, one bar per job.

**Conventions.** Rows are in the order of their stages' starts, unstarted stages last. Lengths are units of an SVG of
`WIDTH`; time runs from the run's creation to its end, or to now. An unstarted job has no bar. A row has at most
`MOST_LANES` lanes; additional jobs share the last one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from api.views.admin import JobSpan
from services.runtime.jobs.queries import title_of

WIDTH = 1000.0
LANE = 10.0
LANE_GAP = 2.0
ROW_GAP = 8.0
LEAST = 2.0
MOST_LANES = 8
TICKS = 5


@dataclass(frozen=True)
class StageBar:
    """A job's bar."""

    job_id: str
    state: str
    attempt: int
    x: float
    y: float
    width: float
    lasted_s: float


@dataclass(frozen=True)
class StageRow:
    """A stage: its jobs as bars, and how many of them are in which state."""

    kind: str
    title: str
    y: float
    height: float
    pieces: tuple[StageBar, ...]
    counts: tuple[tuple[str, int], ...]
    total: int


@dataclass(frozen=True)
class StagePicture:
    """`ticks` are places along time and the seconds they stand for."""

    height: float
    span_s: float
    rows: tuple[StageRow, ...]
    ticks: tuple[tuple[float, float], ...]


def stage_picture(spans: Sequence[JobSpan], at_ns: int) -> StagePicture | None:
    """Return the picture of these jobs, or None without jobs."""
    if not spans:
        return None
    begin_ns = min(span.created_ns for span in spans)
    is_over = all(span.finished_ns is not None for span in spans)
    ends = [span.finished_ns for span in spans if span.finished_ns is not None]
    end_ns = max([begin_ns + 10**6, *(ends if is_over else [at_ns])])
    axis = _Axis(begin_ns, end_ns)
    rows, y = list[StageRow](), 0.0
    for kind in _kinds_in_order(spans):
        row = _row(kind, [span for span in spans if span.kind == kind], axis, y)
        rows.append(row)
        y += row.height + ROW_GAP
    ticks = tuple((WIDTH * i / TICKS, axis.span_s * i / TICKS) for i in range(TICKS + 1))
    return StagePicture(y - ROW_GAP, axis.span_s, tuple(rows), ticks)


def _kinds_in_order(spans: Sequence[JobSpan]) -> list[str]:
    """Return the kinds by the start of their first job; unstarted kinds by creation."""
    began_ns = dict[str, float]()
    for span in spans:
        at_ns = float("inf") if span.started_ns is None else span.started_ns
        began_ns[span.kind] = min(at_ns, began_ns.get(span.kind, float("inf")))
    return sorted(began_ns, key=began_ns.__getitem__)


@dataclass(frozen=True)
class _Axis:
    begin_ns: int
    end_ns: int

    @property
    def span_s(self) -> float:
        return (self.end_ns - self.begin_ns) / 1e9

    def place(self, moment_ns: int) -> float:
        along = (moment_ns - self.begin_ns) / (self.end_ns - self.begin_ns)
        return WIDTH * min(1.0, max(0.0, along))


def _row(kind: str, spans: Sequence[JobSpan], axis: _Axis, y: float) -> StageRow:
    free_from = list[float]()
    pieces = list[StageBar]()
    for span in sorted(spans, key=lambda one: (one.started_ns or axis.end_ns, one.job_id)):
        if span.started_ns is None:
            continue
        begin = axis.place(span.started_ns)
        end_ns = span.finished_ns or axis.end_ns
        width = min(max(LEAST, axis.place(end_ns) - begin), WIDTH - min(begin, WIDTH - LEAST))
        lane = _lane(free_from, begin, begin + width)
        at = y + lane * (LANE + LANE_GAP)
        lasted_s = max(0, end_ns - span.started_ns) / 1e9
        x = round(min(begin, WIDTH - LEAST), 2)
        pieces.append(StageBar(span.job_id, span.state, span.attempt, x, at, round(width, 2), lasted_s))
    counts = dict[str, int]()
    for span in spans:
        counts[span.state] = counts.get(span.state, 0) + 1
    height = max(1, len(free_from)) * (LANE + LANE_GAP) - LANE_GAP
    return StageRow(kind, title_of(kind), y, height, tuple(pieces), tuple(counts.items()), len(spans))


def _lane(free_from: list[float], begin: float, end: float) -> int:
    """Return the first free lane; a new one while there may be more, else the last."""
    for lane, free in enumerate(free_from):
        if free <= begin:
            free_from[lane] = end
            return lane
    if len(free_from) < MOST_LANES:
        free_from.append(end)
        return len(free_from) - 1
    free_from[-1] = max(free_from[-1], end)
    return MOST_LANES - 1
