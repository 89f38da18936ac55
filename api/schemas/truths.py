"""Ground truths and reported rows over the wire."""

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from api.schemas.base import PLAIN, Answer, Body, Instant, Reason, example, example_of
from api.schemas.jobs import JobItem
from api.schemas.phase_bodies import Version
from services.domain.benchmarks.modalities import Modality
from services.domain.benchmarks.phases.reported_results import MOST_ROWS, ReportedKind, ReportedRow
from services.domain.benchmarks.visibility import PERCENT_DIGITS

Ratio = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]


class NewTruthBody(Body):
    """From which version the ground truth is to be made; without one, from the phase's own."""

    model_config = example(dataset="stone-1.1", reason="labels of the lake were mended")

    dataset: Version | None = None
    reason: Reason


class TruthItem(Answer):
    """A ground truth: never its content, only its hash, which every score by it carries in its signature."""

    model_config = example(
        number=2,
        dataset="stone-1.1",
        part="test",
        mask="all",
        state="ready",
        is_active=False,
        frames=7012,
        created_at="2026-07-01T08:00:00Z",
        ready_at="2026-07-01T08:03:12Z",
    )

    id: str
    number: int
    dataset: str
    part: str
    mask: str
    state: Literal["making", "ready", "failed"]
    is_active: bool
    job_id: str | None
    sha256: str | None
    frames: int
    manifest_sha256: str | None
    created_at: Instant
    ready_at: Instant | None


class TruthAccepted(Answer):
    """A ground truth to be and the job that makes it."""

    model_config = example(ground_truth=example_of(TruthItem) | {"state": "making", "sha256": None, "ready_at": None})

    ground_truth: TruthItem
    job: JobItem


class ReportedItem(Body):
    """A result published elsewhere: `source` names authors and place; ratios, not percentages; null was not given.

    `kind` is `ceiling` for labels of a drive scored against labels of the same drive, as `stone ceiling` does. `note`
    is a remark for readers of the board; `percent_digits` is the number of decimals of the printed per cent.
    """

    model_config = example(
        method="a method",
        modality="C+L",
        source="authors, year, table",
        iou_occ=None,
        iou_t=None,
        iou_p=None,
        iou_n=None,
        miou=None,
        note="published on another test split",
        percent_digits=1,
        kind="published",
    )

    method: Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=100, strip_whitespace=True)]
    modality: Modality
    source: Annotated[str, StringConstraints(pattern=PLAIN, min_length=1, max_length=300, strip_whitespace=True)]
    iou_occ: Ratio | None = None
    iou_t: Ratio | None = None
    iou_p: Ratio | None = None
    iou_n: Ratio | None = None
    miou: Ratio | None = None
    note: Annotated[str, StringConstraints(pattern=PLAIN, max_length=600, strip_whitespace=True)] = ""
    percent_digits: Annotated[int, Field(ge=0, le=4)] = PERCENT_DIGITS
    kind: ReportedKind = "published"

    def row(self) -> ReportedRow:
        return ReportedRow(**self.model_dump())


class ReportedBody(Body):
    """All reported rows of the phase at once; `reason` is kept in the audit log."""

    model_config = example(rows=[example_of(ReportedItem)], reason="results as in the paper")

    rows: Annotated[list[ReportedItem], Field(max_length=MOST_ROWS)]
    reason: Reason
