"""Bodies of benchmarks: requests and responses; for phases and metrics, responses only."""

from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import Field

from api.schemas.base import SHA256_EXAMPLE, Answer, Body, Instant, Reason, example, example_of
from api.schemas.grids import GridItem
from api.schemas.phase_bodies import BENCHMARK_PATTERN, NEW_PHASE_EXAMPLE, Heading, NewPhaseBody, Prose, Version
from api.schemas.quality import QualityFields
from services.domain.benchmarks.phases.phases import NewBenchmark, PhaseStatus

PhaseShown = TypeVar("PhaseShown")

SIGNATURE_EXAMPLE = {"metric": "stone-iou-2", "ground_truth": SHA256_EXAMPLE, "mask": "all"}


class SignatureItem(Answer):
    """The facts that make two scores comparable; all scores of a board have the same signature."""

    model_config = example(metric="stone-iou-2", ground_truth=SHA256_EXAMPLE, mask="all")

    metric: str
    ground_truth: str
    mask: str


class ActiveItem(Answer):
    """By what the phase is scored now; `ground_truth` is the number of the version."""

    model_config = example(
        ground_truth=1, metric="stone-iou-2", dataset="stone-1.0", frames=7012, activated_at="2026-05-30T08:00:00Z"
    )

    ground_truth: int
    metric: str
    dataset: str
    frames: int
    manifest_sha256: str
    activated_at: Instant
    signature: SignatureItem


class PhaseItem(QualityFields):
    """A phase: its rules, whether it runs, by what it is scored, and what is shown to whom.

    The quality is that of train and val of its dataset version together.
    """

    model_config = example(
        benchmark="stone",
        **NEW_PHASE_EXAMPLE,
        standing="open",
        visibility=[
            "While the ground truth is hidden and the phase has not ended, all viewers see totals rounded to 4 digits."
        ],
        revision=1,
        created_at="2026-05-29T08:00:00Z",
    )

    id: str
    benchmark: str
    name: str
    title: str
    dataset: str
    part: str
    mask: str
    grid: GridItem
    is_hidden: bool
    every_nth: int | None
    standing: PhaseStatus
    opens_at: Instant | None
    closes_at: Instant | None
    named_from_at: Instant | None
    scorings_per_window: int | None
    window_s: int
    scorings_total: int | None
    validations_per_day: int
    team_members: int
    active: ActiveItem | None
    visibility: list[str]
    revision: int
    created_at: Instant


class PhaseFinding(Answer):
    """A finding about a phase, for administrators."""

    model_config = example(
        code="labels_are_public",
        severity="warning",
        message="2 of the 2 sequences are in train or val of a published version, so anybody may have their labels",
    )

    code: str
    severity: Literal["warning"]
    message: str


class PhaseDetail(PhaseItem):
    """A phase as its administrator sees it, with what was noticed."""

    model_config = example()

    findings: list[PhaseFinding]


class NewBenchmarkBody(Body):
    """A benchmark to be made of a version; without `phases` it has `val` (open) and `test` (hidden).

    A phase that names no version is of the benchmark's. `reason` is kept in the audit log.
    """

    model_config = example(name="stone", title="STONE", description="", dataset="stone-1.0", reason="first season")

    name: Annotated[str, Field(pattern=BENCHMARK_PATTERN)]
    title: Heading = ""
    description: Prose = ""
    dataset: Version
    phases: Annotated[list[NewPhaseBody], Field(min_length=1, max_length=16)] | None = None
    reason: Reason

    def asked(self, user_id: str) -> NewBenchmark:
        return NewBenchmark(user_id=user_id, **self.model_dump(exclude={"dataset", "phases", "reason"}))


class BenchmarkChange(Body):
    """Changes; missing and null keys stay. A public benchmark is visible without an account.

    `reason` is kept in the audit log.
    """

    model_config = example(is_public=True, reason="the season begins")

    title: Heading | None = None
    description: Prose | None = None
    is_public: bool | None = None
    reason: Reason

    def columns(self) -> dict[str, Any]:
        """Return the given values of the benchmark's columns."""
        return self.model_dump(exclude={"reason"}, exclude_none=True)


class BenchmarkShown(Answer, Generic[PhaseShown]):
    """The fields that every answer about a benchmark has; its phases by name or whole."""

    name: str
    title: str
    description: str
    phases: list[PhaseShown]
    is_public: bool
    created_at: Instant


class BenchmarkItem(BenchmarkShown[str]):
    """A benchmark as a list shows it, with the names of its phases."""

    model_config = example(
        name="stone",
        title="STONE",
        description="3D traversability from one sweep and six cameras.",
        phases=["test", "val"],
        is_public=False,
        created_at="2026-05-29T08:00:00Z",
    )


class BenchmarkDetail(BenchmarkShown[PhaseItem]):
    """A benchmark with its phases."""

    model_config = example(**example_of(BenchmarkItem) | {"phases": [example_of(PhaseItem)]})


class CreatedBenchmark(BenchmarkShown[PhaseDetail]):
    """A benchmark with its phases and what was noticed of them."""

    model_config = example(**example_of(BenchmarkItem) | {"phases": [example_of(PhaseDetail)]})


class MetricItem(Answer):
    """A version of the metric: `definition` is Markdown and never changes; test vectors verify it."""

    model_config = example(
        version="stone-iou-2", title="IoU over all evaluated voxels", definition="# …", is_active=True
    )

    version: str
    title: str
    definition: str
    is_active: bool
