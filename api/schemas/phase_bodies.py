"""Bodies of phases: requests of administrators, and the path names of benchmark, phase and metric."""

from datetime import datetime
from typing import Annotated, Any

from fastapi import Path
from pydantic import AfterValidator, AwareDatetime, Field, StringConstraints

from api.schemas.base import EPOCH, PLAIN, PROSE, Answer, Body, Instant, Reason, example
from api.schemas.datasets import VERSION_PATTERN
from services.domain.benchmarks.phases.phases import (
    LONGEST_WINDOW_NS,
    MOST_APART,
    MOST_MEMBERS,
    MOST_SCORINGS,
    Mask,
    NewPhase,
    Part,
    Rules,
)

BENCHMARK_PATTERN = "^[a-z0-9][a-z0-9._-]{0,63}$"
PHASE_PATTERN = "^[a-z0-9][a-z0-9._-]{0,31}$"
METRIC_PATTERN = "^[a-z0-9][a-z0-9._-]{0,31}$"
LATEST_YEAR = 2200
NULLABLE = ("opens_at", "closes_at", "named_from_at", "scorings_per_window", "scorings_total")

BenchmarkName = Annotated[str, Path(pattern=BENCHMARK_PATTERN, examples=["stone"])]
PhaseName = Annotated[str, Path(pattern=PHASE_PATTERN, examples=["test"])]
MetricName = Annotated[str, Path(pattern=METRIC_PATTERN, examples=["stone-iou-2"])]
Heading = Annotated[str, StringConstraints(pattern=PLAIN, max_length=200, strip_whitespace=True)]
Prose = Annotated[str, StringConstraints(pattern=PROSE, max_length=20_000)]
Version = Annotated[str, Field(pattern=VERSION_PATTERN)]
Scorings = Annotated[int, Field(ge=0, le=MOST_SCORINGS)]
WindowS = Annotated[int, Field(ge=1, le=LONGEST_WINDOW_NS // 10**9)]
Members = Annotated[int, Field(ge=1, le=MOST_MEMBERS)]


def _storable(moment: datetime) -> datetime:
    if not EPOCH.year <= moment.year <= LATEST_YEAR:
        raise ValueError(f"the year is {moment.year}; expected {EPOCH.year} to {LATEST_YEAR}")
    return moment


Moment = Annotated[AwareDatetime, AfterValidator(_storable)]

OPENS, CLOSES = "2026-06-01T00:00:00Z", "2026-09-01T00:00:00Z"
RULES_EXAMPLE: dict[str, Any] = {
    "title": "Test: hidden ground truth",
    "opens_at": OPENS,
    "closes_at": CLOSES,
    "named_from_at": None,
    "scorings_per_window": 3,
    "window_s": 604800,
    "scorings_total": 40,
    "validations_per_day": 20,
    "team_members": 10,
}
WHAT_EXAMPLE: dict[str, Any] = {"name": "test", "part": "test", "mask": "all", "is_hidden": True, "every_nth": None}
NEW_PHASE_EXAMPLE: dict[str, Any] = {**WHAT_EXAMPLE, "dataset": "stone-1.0", **RULES_EXAMPLE}


class RulesBody(Body):
    """When a phase runs and how much a team may; null is for as long, or as many, as one likes."""

    model_config = example(**RULES_EXAMPLE)

    title: Heading = ""
    opens_at: Moment | None = None
    closes_at: Moment | None = None
    named_from_at: Moment | None = None
    scorings_per_window: Scorings | None = None
    window_s: WindowS = 604_800
    scorings_total: Scorings | None = None
    validations_per_day: Scorings = 20
    team_members: Members = 10

    def rules(self) -> Rules:
        return Rules(**rule_columns(self, set(RulesBody.model_fields)))


class NewPhaseBody(RulesBody):
    """A new phase: its dataset version, its part, the evaluated voxels, and its rules.

    With `every_nth`, its inputs are one frame in `every_nth`, without poses, stamps or order.
    """

    model_config = example(**NEW_PHASE_EXAMPLE)

    name: Annotated[str, Field(pattern=PHASE_PATTERN)]
    part: Part
    mask: Mask = "all"
    is_hidden: bool
    every_nth: Annotated[int, Field(ge=1, le=MOST_APART)] | None = None
    dataset: Version | None = None

    def asked(self) -> NewPhase:
        return NewPhase(self.name, self.part, self.is_hidden, self.mask, self.rules(), self.every_nth)


class AddedPhaseBody(NewPhaseBody):
    """Another phase of a benchmark, of a version that it names. `reason` is kept in the audit log."""

    model_config = example(**NEW_PHASE_EXAMPLE, reason="a second season")

    dataset: Version
    reason: Reason


class PhaseChange(Body):
    """Changes; missing keys stay, as do null keys that have no null value.

    Version, part, mask and secrecy cannot change once there is a ground truth.
    """

    model_config = example(closes_at="2026-10-01T00:00:00Z", reason="one month more")

    title: Heading | None = None
    opens_at: Moment | None = None
    closes_at: Moment | None = None
    named_from_at: Moment | None = None
    scorings_per_window: Scorings | None = None
    window_s: WindowS | None = None
    scorings_total: Scorings | None = None
    validations_per_day: Scorings | None = None
    team_members: Members | None = None
    dataset: Version | None = None
    part: Part | None = None
    mask: Mask | None = None
    is_hidden: bool | None = None
    reason: Reason

    def columns(self) -> dict[str, Any]:
        """Return the given values of the phase's columns, except for the version, which is a name."""
        given = {name for name in self.model_fields_set if name in NULLABLE or getattr(self, name) is not None}
        return rule_columns(self, given - {"dataset", "reason"})


def rule_columns(body: Body, names: set[str]) -> dict[str, Any]:
    """Return the fields of these names as columns of a phase: instants and seconds in nanoseconds."""
    return dict(_column(name, getattr(body, name)) for name in sorted(names))


def _column(name: str, value: Any) -> tuple[str, Any]:
    if name.endswith("_at"):
        return f"{name.removesuffix('_at')}_ns", None if value is None else ns_of(value)
    return (f"{name.removesuffix('_s')}_ns", value * 10**9) if name == "window_s" else (name, value)


def ns_of(moment: datetime) -> int:
    """Return exact nanoseconds, because a float would lose digits below a microsecond."""
    passed = moment - EPOCH
    return ((passed.days * 86_400 + passed.seconds) * 10**6 + passed.microseconds) * 1000


class PhaseInputItem(Answer):
    """The inputs of one sequence; its tar is at `inputs/{name}.tar`."""

    model_config = example(
        name="n-forest-07", files=13216, size_bytes=41003421, tar_bytes=48210432, created_at="2026-05-03T10:33:40Z"
    )

    name: str
    files: int
    size_bytes: int
    tar_bytes: int
    tar_sha256: str
    created_at: Instant
