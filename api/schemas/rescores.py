"""Re-scores over the wire: the request, its progress, and the changes it would make."""

from typing import Annotated, Literal

from pydantic import Field

from api.schemas.base import ID_EXAMPLE, PLAIN, Answer, Body, IdText, Instant, Reason, example
from api.schemas.jobs import FailureItem

RescoreState = Literal["running", "incomplete", "complete", "activated", "abandoned"]
RATIOS_EXAMPLE = {"iou_occ": 0.512, "iou_t": 0.431, "iou_p": 0.207, "iou_n": 0.388, "miou": 0.342}


class NewRescoreBody(Body):
    """By which pair all standing entries are to be scored; omitted fields keep those of the leaderboard."""

    model_config = example(truth_id=ID_EXAMPLE, metric="stone-iou-2", reason="labels of the quarry corrected")

    truth_id: IdText | None = None
    metric: Annotated[str, Field(pattern=PLAIN, max_length=32)] | None = None
    reason: Reason


class RescoreItem(Answer):
    """A re-score and its progress.

    `total` counts standing submissions: `scored` have their new score, `missing` can still get it (the first 20 are
    named), `hidden` are optional, and the files of `gone` were purged. `state` is running, incomplete (its run has
    ended with submissions missing: start it again), complete, activated or abandoned.
    """

    model_config = example(
        metric="stone-iou-2",
        reason="labels of the quarry corrected",
        state="running",
        total=600,
        scored=412,
        missing=188,
        hidden=0,
        gone=0,
        missing_submission_ids=[ID_EXAMPLE],
        failure=None,
    )

    id: str
    phase_id: str
    truth_id: str
    metric: str
    reason: str
    state: RescoreState
    total: int
    scored: int
    missing: int
    hidden: int
    gone: int
    missing_submission_ids: list[str]
    job_id: str | None
    failure: FailureItem | None
    created_at: Instant
    activated_at: Instant | None
    abandoned_at: Instant | None


class SideItem(Answer):
    """One of the two pairs that are compared."""

    model_config = example(truth_number=2, metric="stone-iou-2")

    truth_id: str
    truth_number: int
    metric: str


class MovedItem(Answer):
    """An entry or baseline by both pairs; null without a score or rank."""

    model_config = example(
        team="Forest",
        method="VoxelNet",
        modality="C+L",
        kind="entry",
        old=RATIOS_EXAMPLE,
        new=RATIOS_EXAMPLE,
        old_rank=4,
        new_rank=2,
        rank_move=2,
        value_move=0.011,
    )

    submission_id: str
    team: str
    method: str
    modality: str
    kind: str
    old: dict[str, float | None] | None
    new: dict[str, float | None] | None
    old_rank: int | None
    new_rank: int | None
    rank_move: int | None
    value_move: float | None


class RescoreDiffAnswer(Answer):
    """The changes that the switch would make, or has made. The ETag identifies the active activation: If-Match of
    `activate`.
    """

    model_config = example(
        is_order_changed=True, is_new_leader=False, largest_rank_move=2, largest_value_move=0.011, without_new_score=0
    )

    rescore: RescoreItem
    old: SideItem | None
    new: SideItem
    is_order_changed: bool
    is_new_leader: bool
    largest_rank_move: int
    largest_value_move: float
    without_new_score: int
    rows: list[MovedItem]


class ActivationItem(Answer):
    """From `activated_at` on the board shows this pair."""

    model_config = example(metric="stone-iou-2")

    id: str
    phase_id: str
    truth_id: str
    metric: str
    rescore_id: str | None
    activated_at: Instant
