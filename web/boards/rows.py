"""Rows of a leaderboard page: groups, tie groups as brackets, intervals on one common axis.

**Conventions.** Made of what the API answers with (`LeaderboardAnswer`), so that nothing is drawn which a viewer may
not read. Sorting by another column moves rows, never ranks; brackets are drawn in the order of the ranks only, since
elsewhere a group is not together. The bests are those of the ranked rows.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby, pairwise
from typing import Literal
from urllib.parse import urlencode

from api.schemas.leaderboard import BoardRow, ChangeItem, LeaderboardAnswer
from api.views.boards import board_answer
from services.domain.benchmarks.boards.board import board
from services.domain.benchmarks.boards.entries import BoardQuery, EntryStatus
from services.domain.benchmarks.visibility import Viewer
from services.runtime.platform import Platform
from web.boards.comparison import Axis, axis_over

Sort = Literal["rank", "miou", "iou_occ", "iou_t", "iou_p", "iou_n", "danger", "submitted", "method"]
RATIO_COLUMNS = (("iou_occ", "occupied"), ("iou_t", "T"), ("iou_p", "P"), ("iou_n", "N"))
VALUE_NAMES = ("miou", *(name for name, _ in RATIO_COLUMNS), "danger")
TITLES: Mapping[EntryStatus, str] = {
    "ceiling": "Ceiling: the same drive labelled twice",
    "ranked": "Entries, and baselines without a rank",
    "baseline": "Baselines (not ranked)",
    "undefined": "Unranked entries (a class is undefined)",
    "reported": "Reported by others, not evaluated here",
}
FEW = 5


@dataclass(frozen=True)
class BoardWhisker:
    """A row's mIoU and its interval on the axis; the ends are null where the interval is not shown."""

    at: str
    low: str | None
    high: str | None
    length: str | None


@dataclass(frozen=True)
class ShownRow:
    """A row of the board with its figures.

    `tied` is the number of rows that a bracket starting here spans, 0 within a bracket; `best` names columns.
    `note_number` is the number of its note in the group, counted from 1; 0 without a note.
    """

    row: BoardRow
    whisker: BoardWhisker | None
    tied: int
    best: frozenset[str]
    note_number: int


@dataclass(frozen=True)
class Group:
    """Rows of one standing; `notes` are what must be known of some of them, each once."""

    standing: EntryStatus
    title: str
    rows: tuple[ShownRow, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ShownBoard:
    """The board that `board_table` of `parts/boards.html` draws; `left_out` ranked entries are not among the rows."""

    answer: LeaderboardAnswer
    groups: tuple[Group, ...]
    axis: Axis
    sort: Sort
    left_out: int = 0

    @property
    def path(self) -> str:
        """The page of the board."""
        return f"/benchmarks/{self.answer.benchmark}/{self.answer.phase}"

    @property
    def has_brackets(self) -> bool:
        return any(row.tied > 1 for group in self.groups for row in group.rows)

    @property
    def has_danger(self) -> bool:
        return any(row.danger is not None for row in self.answer.rows)

    @property
    def comparable(self) -> int:
        """The number of rows that can be compared."""
        return sum(shown.row.submission_id is not None for group in self.groups for shown in group.rows)

    @property
    def asked(self) -> dict[str, str]:
        """The parameters of this board's query that differ from the default."""
        answer = self.answer
        given = {"track": answer.track, "entries": answer.entries, "sort": self.sort}
        usual = {"track": "all", "entries": "best", "sort": "rank"}
        when = {} if answer.as_of is None else {"as_of": answer.as_of.isoformat().replace("+00:00", "Z")}
        return {name: value for name, value in given.items() if value != usual[name]} | when

    def link(self, **changed: str | None) -> str:
        """Return the URL of this board with these changes of its query; None removes a parameter."""
        query = {name: value for name, value in (self.asked | changed).items() if value is not None}
        return f"{self.path}?{urlencode(query)}" if query else self.path

    def file(self, form: str) -> str:
        """Return the API's URL of this board in this form."""
        at = f"/api/v1/benchmarks/{self.answer.benchmark}/phases/{self.answer.phase}/leaderboard"
        query = {name: value for name, value in self.asked.items() if name != "sort"} | {"format": form}
        return f"{at}?{urlencode(query)}"


@dataclass(frozen=True)
class _BoardScale:
    """The axis, the best values and the order that all rows of a board share."""

    axis: Axis
    bests: Mapping[str, float]
    sort: Sort


def shown_board(
    platform: Platform, phase_id: str, viewer: Viewer, query: BoardQuery | None = None, sort: Sort = "rank"
) -> ShownBoard:
    """Return the board of a phase as the viewer may see it. Raises `store_unavailable`."""
    return board_with_figures(board_answer(board(platform, phase_id, query or BoardQuery(), viewer), viewer), sort)


def board_with_figures(answer: LeaderboardAnswer, sort: Sort = "rank") -> ShownBoard:
    """Return the board with its figures; rows are in the requested order within their standing."""
    scale = _BoardScale(
        axis_over(value for row in answer.rows for value in (row.ratios.miou, *(_interval(row) or ()))),
        _bests([row for row in answer.rows if row.standing == "ranked"]),
        sort,
    )
    groups = tuple(_group(standing, rows, scale) for standing, rows in _by_group(answer.rows))
    return ShownBoard(answer, groups, scale.axis, sort, answer.ranked_total - _ranked(answer.rows))


def shortened(whole: ShownBoard, most: int = FEW) -> ShownBoard:
    """Return the best `most` ranked rows with their axis, and the best ceiling, baseline and reported row."""
    shown: dict[EntryStatus, int] = {"ceiling": 1, "ranked": most, "baseline": 1, "reported": 1}
    rows: list[BoardRow] = []
    for row in (shown_row.row for group in whole.groups for shown_row in group.rows):
        if shown.get(row.standing, 0):
            shown[row.standing] -= 1
            rows.append(row)
    return board_with_figures(whole.answer.model_copy(update={"rows": rows}), whole.sort)


def _ranked(rows: Iterable[BoardRow]) -> int:
    return sum(row.standing == "ranked" for row in rows)


def _by_group(rows: Iterable[BoardRow]) -> list[tuple[EntryStatus, list[BoardRow]]]:
    """Group the rows by standing; baselines are placed among the ranked entries, if there are any."""
    groups: dict[EntryStatus, list[BoardRow]] = {standing: [] for standing in TITLES}
    for row in rows:
        groups[row.standing].append(row)
    if groups["ranked"]:
        groups["ranked"] = _with_baselines(groups["ranked"], groups.pop("baseline"))
    return [(standing, rows_of) for standing, rows_of in groups.items() if rows_of]


def _with_baselines(ranked: list[BoardRow], baselines: Iterable[BoardRow]) -> list[BoardRow]:
    """Insert each baseline below the entries that score more, without a rank, and never within a tie group."""
    placed = list(ranked)
    for row in baselines:
        score = row.ratios.miou if row.ratios.miou is not None else -1.0
        above = sum(other.ratios.miou is not None and other.ratios.miou >= score for other in placed)
        while 0 < above < len(placed) and _are_tied(placed[above - 1], placed[above]):
            above += 1
        placed.insert(above, row)
    return placed


def _are_tied(one: BoardRow, other: BoardRow) -> bool:
    return one.tie_group is not None and one.tie_group == other.tie_group


def _group(standing: EntryStatus, rows: Sequence[BoardRow], scale: _BoardScale) -> Group:
    placed = _sorted(rows, scale.sort)
    brackets = _brackets(placed) if scale.sort == "rank" and standing == "ranked" else [1] * len(placed)
    notes = tuple(dict.fromkeys(row.note for row in placed if row.note is not None))
    shown = (
        ShownRow(row, _whisker(row, scale.axis), tied, _best_in(row, scale.bests), _number_of(row.note, notes))
        for row, tied in zip(placed, brackets, strict=True)
    )
    return Group(standing, TITLES[standing], tuple(shown), notes)


def _number_of(note: str | None, notes: Sequence[str]) -> int:
    return 0 if note is None else 1 + notes.index(note)


def _sorted(rows: Sequence[BoardRow], sort: Sort) -> list[BoardRow]:
    """Sort ratios and times falling, danger rising, unknown values last; methods alphabetically."""
    if sort == "rank":
        return list(rows)
    if sort == "method":
        return sorted(rows, key=lambda row: row.method.casefold())
    value_of: Callable[[BoardRow], float | None] = _submitted if sort == "submitted" else lambda row: _value(row, sort)
    sign = 1 if sort == "danger" else -1
    return sorted(rows, key=lambda row: (value_of(row) is None, sign * (value_of(row) or 0.0)))


def _submitted(row: BoardRow) -> float | None:
    return None if row.submitted_at is None else row.submitted_at.timestamp()


def _value(row: BoardRow, name: str) -> float | None:
    if name == "danger":
        return None if row.danger is None else row.danger.n_predicted_drivable_ratio
    value: float | None = getattr(row.ratios, name)
    return value


def _brackets(rows: Sequence[BoardRow]) -> list[int]:
    spans: list[int] = []
    for number, together in groupby(rows, key=lambda row: row.tie_group):
        count = len(list(together))
        spans += [1] * count if number is None else [count, *[0] * (count - 1)]
    return spans


def _interval(row: BoardRow) -> tuple[float, float] | None:
    return None if row.intervals is None else row.intervals.miou


def _whisker(row: BoardRow, axis: Axis) -> BoardWhisker | None:
    if row.ratios.miou is None:
        return None
    low, high = _interval(row) or (None, None)
    if low is None or high is None:
        return BoardWhisker(axis.at(row.ratios.miou), None, None, None)
    return BoardWhisker(axis.at(row.ratios.miou), axis.at(low), axis.at(high), axis.width(high, low))


def _bests(rows: Sequence[BoardRow]) -> dict[str, float]:
    known = {name: [value for row in rows if (value := _value(row, name)) is not None] for name in VALUE_NAMES}
    best_of = {"danger": min}
    return {name: best_of.get(name, max)(values) for name, values in known.items() if len(values) > 1}


def _best_in(row: BoardRow, bests: Mapping[str, float]) -> frozenset[str]:
    if row.standing != "ranked":
        return frozenset()
    return frozenset(name for name, best in bests.items() if _value(row, name) == best)


# The history of a leaderboard: slider stops, and a curve of the best mIoU.
#
# **Conventions.** Stops are evenly apart, whatever time passed between them, so that each can be reached; the last is
# the board of now. Places are per cent of the width and of the height.


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
            shown.link(as_of=None if index == last else _spelled(change.at)),
            change,
            f"{100 * index / max(last, 1):.2f}%",
            _height(change.best_miou, axis),
        )
        for index, change in enumerate(changes)
    )
    return BoardTimeline(stops, _steps(stops), _chosen(stops, shown.answer.as_of))


def _steps(stops: Sequence[TimelineStop]) -> tuple[CurveStep, ...]:
    """Return steps: level until the next stop, then up or down to it."""
    steps: list[CurveStep] = []
    for stop, following in pairwise(stops):
        if stop.y is not None:
            steps.append(CurveStep(stop.x, stop.y, following.x, stop.y))
        if stop.y is not None and following.y is not None and stop.y != following.y:
            steps.append(CurveStep(following.x, stop.y, following.x, following.y))
    return tuple(steps)


def _height(best: float | None, axis: Axis) -> str | None:
    return None if best is None else f"{100 - axis.place(best):.2f}%"


def _chosen(stops: Sequence[TimelineStop], as_of: datetime | None) -> int:
    if as_of is None:
        return len(stops) - 1
    return max(sum(stop.change.at <= as_of for stop in stops) - 1, 0)


def _spelled(moment: datetime) -> str:
    return moment.isoformat().replace("+00:00", "Z")
