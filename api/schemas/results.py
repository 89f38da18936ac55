"""Results of a submission over the wire."""

from typing import Annotated

from fastapi import Query

from api.schemas.base import Answer, IdQuery, Instant, example, example_of
from api.schemas.class_counts import ClassCounts
from api.schemas.leaderboard import (
    DangerItem,
    IntervalsItem,
    PairItem,
    RatiosItem,
)
from services.domain.benchmarks.submissions.results import By
from services.domain.benchmarks.visibility import Secrecy
from stone.scoring.intervals import Silence

SCORED_AT = "2026-06-02T09:14:02.512000Z"

ScoreQuery = Annotated[
    IdQuery, Query(description="Id of an older score of the submission (default: the score in force).")
]
ByQuery = Annotated[By, Query(description="Grouping of the frames; the distance is from the robot.")]


class ExtrasItem(DangerItem):
    """Figures that are not ranked.

    - Danger: share of N voxels predicted drivable (T or P), and predicted T alone; over-caution: share of T voxels
      predicted N.
    - IoU of drivable columns: without N up to the robot's height of 1.6 m above the surface (`clear_drivable_iou`), or
      without any N (`bev_drivable_iou`).
    """

    model_config = example(
        t_predicted_n_ratio=0.058,
        bev_drivable_iou=0.61,
        clear_drivable_iou=0.66,
    )

    t_predicted_n_ratio: float | None
    bev_drivable_iou: float | None
    clear_drivable_iou: float | None


class ScopedIntervals(Answer):
    """About the ground of the ground truth, and about unseen places."""

    model_config = example(new_place=dict.fromkeys(example_of(RatiosItem)))

    these_places: IntervalsItem
    new_place: IntervalsItem


class ScopedSilences(Answer):
    """Reason why there is no interval, by ratio; null if there is one."""

    model_config = example(
        these_places=dict.fromkeys(example_of(RatiosItem)),
        new_place=dict.fromkeys(example_of(RatiosItem), "few_sequences"),
    )

    these_places: dict[str, Silence | None]
    new_place: dict[str, Silence | None]


class ScoreItem(Answer):
    """A score of the submission that may be read by its id; `is_active`: by the pair in force."""

    model_config = example(ground_truth=1, metric="stone-iou-2", is_active=True, scored_at=SCORED_AT)

    score_id: str
    ground_truth: int
    metric: str
    is_active: bool
    scored_at: Instant


class ResultsAnswer(Answer):
    """The scores of a submission. Null values are undefined, or not shown to the caller.

    `total` is rounded to `ratio_digits` if `is_rounded`. `within_occupied` are the same ratios with only the voxels
    that the ground truth calls occupied. `tolerant` are the ratios with voxels of a class paired if they are at most
    one voxel apart in height, and `columns` those of columns that count once. Both are null for scores of an earlier
    version. Rows of `confusion` are the ground truth, columns the prediction.
    """

    model_config = example(
        benchmark="stone",
        phase="val",
        team="Terrain Gang",
        method="GroundNet",
        description="Trained on train only.",
        modality="C+L",
        kind="entry",
        secrecy="open",
        is_rounded=False,
        ratio_digits=4,
        confusion=[[0] * 4] * 4,
        submitted_at=SCORED_AT,
        scored_at=SCORED_AT,
    )

    submission_id: str
    score_id: str
    benchmark: str
    phase: str
    team: str | None
    method: str
    description: str | None
    modality: str
    kind: str
    pair: PairItem
    secrecy: Secrecy
    is_rounded: bool
    ratio_digits: int
    total: RatiosItem
    within_occupied: RatiosItem | None
    tolerant: RatiosItem | None
    columns: RatiosItem | None
    support: ClassCounts | None
    confusion: list[list[int]] | None
    extras: ExtrasItem | None
    intervals: ScopedIntervals | None
    silences: ScopedSilences | None
    submitted_at: Instant
    scored_at: Instant
    scores: list[ScoreItem]


class PartItem(Answer):
    """The result for one sequence, environment, illumination or ring of distance."""

    model_config = example(name="forest", frames=1400)

    name: str
    ratios: RatiosItem
    support: ClassCounts
    frames: int


class BreakdownAnswer(Answer):
    """The parts of a result; empty if nothing is known to group by."""

    model_config = example(by="environment")

    submission_id: str
    score_id: str
    pair: PairItem
    by: By
    parts: list[PartItem]


class ProvenanceAnswer(Answer):
    """The sources and code of a score; null values are not shown to the caller.

    `ground_truth_sha256` covers every evaluated voxel, `prediction_sha256` the zip, `content_sha256` all counts, so
    that it is equal for equal predictions.
    """

    model_config = example(
        mask="all",
        code_version="5613fe395006",
        prediction_sha256=None,
        content_sha256=None,
        submitted_at=SCORED_AT,
        settled_at=SCORED_AT,
        scored_at=SCORED_AT,
    )

    submission_id: str
    score_id: str
    pair: PairItem
    manifest_sha256: str
    mask: str
    code_version: str
    prediction_sha256: str | None
    size_bytes: int | None
    content_sha256: str | None
    submitted_at: Instant
    settled_at: Instant | None
    scored_at: Instant
