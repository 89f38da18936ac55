"""Splits and proposals over the wire."""

from typing import Annotated, Literal

from pydantic import AliasChoices, Field

from api.schemas.base import ID_EXAMPLE, Answer, Body, IdText, Reason, example, example_of
from api.schemas.class_counts import ClassCounts
from api.schemas.quality import QualityFields
from api.schemas.statistics import VoxelRatios
from stone.splits.splits import MOST_SEQUENCES

Ids = Annotated[list[IdText], Field(max_length=MOST_SEQUENCES)]
Size = Annotated[int, Field(ge=0, le=MOST_SEQUENCES)]


class SplitsToJudge(Body):
    """Unsaved splits, by the ids of their sequences."""

    model_config = example(train=[ID_EXAMPLE], val=[], test=[])

    train: Ids
    val: Ids
    test: Ids


class SplitsBody(SplitsToJudge):
    """Which sequences are in train, val and test, by id: all of them at once. `reason` is kept in the audit log."""

    model_config = example(train=[ID_EXAMPLE], val=[], test=[], reason="first release")

    reason: Reason


class Sizes(Answer):
    """Number of sequences in each part."""

    model_config = example(train=31, val=7, test=5)

    train: int
    val: int
    test: int


class SizesAsked(Body):
    """Requested number of sequences in each part."""

    model_config = example(train=31, val=7, test=5)

    train: Size
    val: Size
    test: Size


class ProposalBody(Body):
    """A request for a proposal from all labelled sequences except those to leave out."""

    model_config = example(sizes={"train": 1, "val": 0, "test": 0}, leave_out=[])

    sizes: SizesAsked
    leave_out: Ids = Field(default_factory=list)


class RuleItem(Answer):
    """Verdict of a rule: broken (`error`), or impossible with these data (`warning`)."""

    model_config = example(
        code="day_and_night",
        severity="warning",
        message="night is not in val; the data do not allow it: it is in 2 sequences of 20 s or more, 3 splits ask "
        "for one each",
        sequence_ids=[ID_EXAMPLE],
    )

    code: str
    severity: Literal["error", "warning"]
    message: str
    sequence_ids: list[str] = Field(validation_alias=AliasChoices("sequences", "sequence_ids"))


class GapItem(Answer):
    """Distance between train and test: the least distance of their tracks and the least time between them.

    `nearest` and `soonest` name the two sequences. Both are null if no two tracks can be compared; distances in place
    require tracks in one map. `unknown` sequences have no track.
    """

    model_config = example(
        distance_m=412.7,
        nearest=["lake-2026-05-03", "lake-2026-05-04"],
        time_s=61200.0,
        soonest=["lake-2026-05-03", "lake-2026-05-04"],
        unknown=0,
        message="train and test are at least 413 m apart in place (lake-2026-05-03 and lake-2026-05-04); at least 17 h "
        "apart in time (lake-2026-05-03 and lake-2026-05-04)",
    )

    distance_m: float | None
    nearest: list[str] | None
    time_s: float | None
    soonest: list[str] | None
    unknown: int
    message: str


class VerdictsAnswer(Answer):
    """The rules' verdicts on splits; `revision` is that of the saved draft splits.

    `gap` is null if train or test is empty.
    """

    model_config = example(revision=4, can_be_put=True)

    revision: int
    can_be_put: bool
    findings: list[RuleItem]
    gap: GapItem | None


class DrivenItem(QualityFields):
    """Place, time and size of a drive; null values are unknown."""

    model_config = example(
        name="lake-2026-05-03",
        environment="lake",
        illumination="dusk",
        daylight="day",
        region="Gyeonggi",
        frames=1200,
        duration_s=120.0,
        distance_m=148.2,
    )

    name: str
    environment: str
    illumination: str
    daylight: str
    region: str
    frames: int
    duration_s: float
    distance_m: float | None


class SplitEntry(DrivenItem):
    """A labelled sequence in the dataset; `drive` names the drive that it shares with other sequences, or ''."""

    model_config = example(drive="")

    sequence_id: str
    drive: str
    voxels: ClassCounts | None


class SplitsAnswer(Answer):
    """The draft splits: all sizes, and the sequences that the caller may see.

    `findings` and `gap` cover all sequences, and are null for callers who do not see all.
    """

    model_config = example(
        revision=4,
        sizes={"train": 1, "val": 0, "test": 0},
        val=[],
        test=[],
        unassigned=[],
        findings=[example_of(RuleItem)],
        gap=example_of(GapItem),
    )

    revision: int
    sizes: Sizes
    train: list[SplitEntry]
    val: list[SplitEntry]
    test: list[SplitEntry]
    unassigned: list[SplitEntry]
    findings: list[RuleItem] | None
    gap: GapItem | None


class SharesItem(Answer):
    """The share of the assigned seconds in a part, and the class shares of its occupied voxels (null: unknown)."""

    model_config = example(
        sequences=31,
        duration_ratio=0.72,
        class_ratios={"traversable": 0.18, "potentially_traversable": 0.26, "non_traversable": 0.56},
    )

    sequences: int
    duration_ratio: float
    class_ratios: VoxelRatios | None


class Shares(Answer):
    """The shares of the whole and of each part."""

    whole: SharesItem
    train: SharesItem
    val: SharesItem
    test: SharesItem


class ProposalAnswer(Answer):
    """A split that keeps every rule (`is_feasible`); else the one that bends them least, and in `conflict` why.

    `conflict` holds rules that cannot all be kept, each with its numbers; without any one of them the others could be.
    `findings` are what the rules say of the proposal itself. Nothing is saved.
    """

    model_config = example(
        is_feasible=True,
        is_best=True,
        val=[],
        test=[],
        conflict=[],
        shares=dict.fromkeys(("whole", "train", "val", "test"), example_of(SharesItem)),
    )

    is_feasible: bool
    is_best: bool
    train: list[SplitEntry]
    val: list[SplitEntry]
    test: list[SplitEntry]
    conflict: list[RuleItem]
    findings: list[RuleItem]
    gap: GapItem | None
    shares: Shares
