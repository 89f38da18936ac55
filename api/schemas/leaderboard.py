"""Boards and comparisons over the wire."""

from typing import Annotated, Literal

from fastapi import Query
from pydantic import AliasChoices, Field

from api.schemas.base import ID_EXAMPLE, ID_PATTERN, Answer, Instant, example, example_of
from api.schemas.class_counts import ClassCounts
from api.schemas.phase_bodies import Moment
from services.domain.benchmarks.boards.entries import EntryStatus, Track, Which
from services.domain.benchmarks.visibility import Secrecy
from stone.scoring.intervals import Scope, Silence

SIGNATURE_EXAMPLE = "metric:stone-iou-2|truth:9f86d081884c7d65|mask:all|grid:256x256x32@0.2m|classes:0=free,1=T,2=P,3=N"

Form = Literal["json", "csv", "parquet", "md", "tex"]
TrackQuery = Annotated[Track, Query(description="Modality that the board is limited to, or `all`.")]
AsOfQuery = Annotated[Moment | None, Query(description="Time of the board (default: now).")]
EntriesQuery = Annotated[Which, Query(description="Which entries are shown: the best of each team, or all.")]
FormQuery = Annotated[
    Form, Query(alias="format", description="Format of the answer; md and tex are tables for papers.")
]
SubmissionQuery = Annotated[str, Query(pattern=ID_PATTERN, description="Id of a submission of this phase.")]

Interval = tuple[float, float]


class RatiosItem(Answer):
    """The five ratios in [0, 1]; null where undefined."""

    model_config = example(miou=0.2431, iou_occ=0.4119, iou_t=0.3120, iou_p=0.1980, iou_n=0.2193)

    miou: float | None
    iou_occ: float | None
    iou_t: float | None
    iou_p: float | None
    iou_n: float | None


class IntervalsItem(Answer):
    """The 95 % interval of each ratio; null if there is none."""

    model_config = example(**{name: [0.2389, 0.2474] for name in example_of(RatiosItem)})

    miou: Interval | None
    iou_occ: Interval | None
    iou_t: Interval | None
    iou_p: Interval | None
    iou_n: Interval | None


class DangerItem(Answer):
    """The shares of N voxels that are predicted drivable (T or P), and T alone; null without N. Lower is better."""

    model_config = example(n_predicted_drivable_ratio=0.062, n_predicted_t_ratio=0.031)

    n_predicted_drivable_ratio: float | None
    n_predicted_t_ratio: float | None


class PairItem(Answer):
    """The ground truth (`ground_truth` is its number in the phase) and metric of scores.

    `signature` is null while there is no score. Sequences that continue each other count as one drive.
    """

    model_config = example(
        ground_truth=1, metric="stone-iou-2", signature=SIGNATURE_EXAMPLE, frames=7012, sequences=5, drives=5
    )

    ground_truth: int = Field(validation_alias=AliasChoices("truth_number", "ground_truth"))
    ground_truth_sha256: str = Field(validation_alias=AliasChoices("truth_sha256", "ground_truth_sha256"))
    metric: str
    signature: str | None
    frames: int
    sequences: int
    drives: int


class BoardPairItem(PairItem):
    """The pair in force at the time of a board."""

    model_config = example(activated_at="2026-05-30T08:00:00Z")

    activated_at: Instant


class BoardRow(Answer):
    """A line of a board. Null values are unknown, not applicable, or not shown to the caller.

    `standing`: only ranked entries have a rank. A baseline is shown beside them, and an undefined entry lacks a ratio.
    A reported result was published elsewhere (`source`, `note`) and not scored here. A ceiling is the score of labels
    of a drive against other labels of the same drive: no entry can be expected to score above it. In per cent a row has
    `percent_digits` decimals; a reported row has as many as were printed.
    """

    model_config = example(
        standing="ranked",
        rank=1,
        rank_interval=[1, 2],
        tie_group=1,
        team="Terrain Gang",
        is_yours=False,
        method="GroundNet",
        modality="C+L",
        intervals=None,
        support=None,
        percent_digits=2,
        submitted_at="2026-06-02T09:12:44.120000Z",
    )

    standing: EntryStatus
    rank: int | None
    rank_interval: tuple[int, int] | None
    tie_group: int | None
    submission_id: str | None
    score_id: str | None
    team: str | None
    is_yours: bool
    method: str
    modality: str
    ratios: RatiosItem
    intervals: IntervalsItem | None
    support: ClassCounts | None
    danger: DangerItem | None
    source: str | None
    note: str | None
    percent_digits: int
    submitted_at: Instant | None


class LeaderboardAnswer(Answer):
    """A board: one pair of ground truth and metric, its rows in order, and notes for readers (`notes`).

    Rows are ordered by `ordered_by`, each rounded to `ratio_digits`; equal values share a rank. If `is_rounded`, the
    caller sees rounded values too, because the phase is running and hides its truth. `ranked_total` counts ranked
    entries, of these at most 2,000 are listed. `pair` is null before there is a ground truth.
    """

    model_config = example(
        benchmark="stone",
        phase="test",
        track="all",
        entries="best",
        is_hidden=True,
        secrecy="running",
        is_rounded=True,
        ratio_digits=4,
        ordered_by=["miou", "iou_occ", "iou_n", "submitted_at"],
        interval_level=0.95,
        ranked_total=1,
        notes=["5 sequences are few: no difference can have a p below 0.0625."],
    )

    benchmark: str
    phase: str
    track: Track
    entries: Which
    as_of: Instant | None
    is_hidden: bool
    secrecy: Secrecy
    is_rounded: bool
    ratio_digits: int
    ordered_by: list[str]
    interval_level: float
    pair: BoardPairItem | None
    ranked_total: int
    rows: list[BoardRow]
    notes: list[str]


class ChangeItem(Answer):
    """A change of the board at `at`: rows `entered` or `left`, or scores are by another pair (`is_new_pair`).

    `best_miou` is the highest mIoU of the ranked entries since then, rounded; null if there is none.
    """

    model_config = example(at="2026-06-02T09:14:02.512000Z", entered=1, left=0, is_new_pair=False, best_miou=0.2431)

    at: Instant
    entered: int
    left: int
    is_new_pair: bool
    best_miou: float | None


class HistoryAnswer(Answer):
    """The changes of a board, oldest first: moments for `as_of`. If there are very many, only the last of each day is
    listed.
    """

    model_config = example(benchmark="stone", phase="test", track="all")

    benchmark: str
    phase: str
    track: Track
    changes: list[ChangeItem]


class DifferenceItem(Answer):
    """Frame by frame difference a − b: the interval of its true value, and the two-sided p of Student's t."""

    model_config = example(interval=[0.0012, 0.0031], standard_error=0.00046, degrees_of_freedom=18.2, p=0.0002)

    interval: Interval
    standard_error: float
    degrees_of_freedom: float
    p: float


class SignFlipItem(Answer):
    """The exact test over sequences; no result of so few can have a p below `smallest_p`."""

    model_config = example(sequences=5, p=0.0625, smallest_p=0.0625)

    sequences: int
    p: float
    smallest_p: float


class RatioDifferenceItem(Answer):
    """One ratio of both; null if undefined or withheld. `these_places` applies to the ground of the ground truth,
    `new_place` to other ground; if one is null, `silences` has the code of the reason.
    """

    model_config = example(
        a=0.2431,
        b=0.2410,
        difference=0.0021,
        new_place=None,
        silences={"these_places": None, "new_place": "few_sequences"},
    )

    a: float | None
    b: float | None
    difference: float | None
    these_places: DifferenceItem | None
    new_place: DifferenceItem | None
    silences: dict[Scope, Silence | None] | None
    sign_flip: SignFlipItem | None


class ComparisonAnswer(Answer):
    """Two submissions by the same pair. `is_withheld`: only totals are shown while the phase hides its truth."""

    model_config = example(
        a=ID_EXAMPLE,
        b=ID_EXAMPLE[::-1],
        is_withheld=False,
        interval_level=0.95,
        ratios=dict.fromkeys(example_of(RatiosItem), example_of(RatioDifferenceItem)),
    )

    a: str
    b: str
    pair: PairItem
    is_withheld: bool
    interval_level: float
    ratios: dict[str, RatioDifferenceItem]
