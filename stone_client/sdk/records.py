"""The records of a server as frozen dataclasses.

**Conventions.** A record has the most used fields; `record` is the API's whole JSON object (`/api/v1/openapi.json`).
Times are ISO 8601 in UTC. A ratio is in [0, 1], or None if it is undefined or hidden from the caller.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from stone_client.sdk.tables import Table

Item = Mapping[str, Any]
Ratios = Mapping[str, "float | None"]
R = TypeVar("R")


def record_of(kind: type[R], item: Item, **more: Any) -> R:
    """Return a record of this kind with fields from a JSON object; absent fields are None."""
    names = {field.name for field in fields(kind)}  # type: ignore[arg-type]
    known = {name: item.get(name) for name in names - {"record", *more} if not name.startswith("_")}
    return kind(**{**known, **more, **({"record": item} if "record" in names else {})})


@dataclass(frozen=True)
class LabelSet:
    """A label set of a sequence. `is_counting`: it is the active label set."""

    id: str
    profile: str
    frames: int
    is_counting: bool
    code_version: str
    created_at: str
    record: Item = field(repr=False, compare=False)


@dataclass(frozen=True)
class Upload:
    """An upload in progress, with the bytes on the server."""

    id: str
    filename: str
    state: str
    offset_bytes: int
    length_bytes: int
    record: Item = field(repr=False, compare=False)


@dataclass(frozen=True)
class Phase:
    """A phase of a benchmark; `standing` is its state, such as open or closed."""

    benchmark: str
    name: str
    dataset: str
    part: str
    standing: str
    is_hidden: bool
    closes_at: str | None
    record: Item = field(repr=False, compare=False)


@dataclass(frozen=True)
class Benchmark:
    """A benchmark and its phases."""

    name: str
    title: str
    phases: tuple[Phase, ...]
    record: Item = field(repr=False, compare=False)

    def phase(self, name: str) -> Phase:
        """Return its phase of this name. Raises KeyError."""
        return {phase.name: phase for phase in self.phases}[name]


@dataclass(frozen=True)
class BoardRow:
    """A line of a leaderboard; `standing` is ranked, baseline, undefined, reported or ceiling."""

    rank: int | None
    standing: str
    method: str
    modality: str
    team: str | None
    ratios: Ratios
    submission_id: str | None
    record: Item = field(repr=False, compare=False)


@dataclass(frozen=True)
class Leaderboard:
    """The board of a phase, its rows in order."""

    benchmark: str
    phase: str
    track: str
    rows: Table[BoardRow]
    record: Item = field(repr=False, compare=False)

    def to_pandas(self) -> Any:
        """Return a DataFrame of its rows. Requires pandas."""
        return self.rows.to_pandas()


@dataclass(frozen=True)
class Part:
    """The scores of one part of a submission: a sequence, an environment, an illumination or a ring of distance."""

    name: str
    frames: int
    ratios: Ratios
    record: Item = field(repr=False, compare=False)


@dataclass(frozen=True)
class Results:
    """The scores of a submission: `total` ratios, their `intervals` by scope, `confusion` [truth, prediction]."""

    submission_id: str
    benchmark: str
    phase: str
    method: str
    modality: str
    total: Ratios
    intervals: Item | None
    confusion: list[list[int]] | None
    record: Item = field(repr=False, compare=False)


@dataclass(frozen=True)
class RatioDifference:
    """One ratio of two submissions: `difference` is a − b; `p` is None if nothing can be inferred."""

    ratio: str
    a: float | None
    b: float | None
    difference: float | None
    interval: tuple[float, float] | None
    p: float | None


@dataclass(frozen=True)
class Comparison:
    """Two submissions to one phase, ratio by ratio."""

    a: str
    b: str
    rows: Table[RatioDifference]
    record: Item = field(repr=False, compare=False)

    def __getitem__(self, ratio: str) -> RatioDifference:
        return {row.ratio: row for row in self.rows}[ratio]


def benchmark_of(item: Item) -> Benchmark:
    """Return a benchmark with its phases."""
    return record_of(Benchmark, item, phases=tuple(record_of(Phase, phase) for phase in item["phases"]))


def leaderboard_of(item: Item) -> Leaderboard:
    """Return a board with its rows."""
    return record_of(Leaderboard, item, rows=Table(BoardRow, (record_of(BoardRow, row) for row in item["rows"])))


def comparison_of(item: Item) -> Comparison:
    """Return a comparison with a row for each ratio."""
    return record_of(
        Comparison, item, rows=Table(RatioDifference, (_difference(*pair) for pair in item["ratios"].items()))
    )


def _difference(ratio: str, item: Item) -> RatioDifference:
    here = item["these_places"] or {}
    bounds = here.get("interval")
    interval = None if bounds is None else (float(bounds[0]), float(bounds[1]))
    return record_of(RatioDifference, item, ratio=ratio, interval=interval, p=here.get("p"))
