"""Splits and proposals over the wire."""

from typing import Annotated, Literal

from pydantic import AliasChoices, Field

from api.schemas.base import ID_EXAMPLE, Answer, Body, IdText, Reason, example, example_of
from api.schemas.quality import QualityFields
from api.schemas.statistics import VoxelRatios, VoxelsItem
from stone.splits.splits import MOST_SEQUENCES

Ids = Annotated[list[IdText], Field(max_length=MOST_SEQUENCES)]
Size = Annotated[int, Field(ge=0, le=MOST_SEQUENCES)]


class SplitsToJudge(Body):
    """Splits that nobody put yet, by the ids of their sequences."""

    model_config = example(train=[ID_EXAMPLE], val=[], test=[])

    train: Ids
    val: Ids
    test: Ids


class SplitsBody(SplitsToJudge):
    """Which sequences are in train, val and test, by id: all of them at once. `reason` is kept in the audit log."""

    model_config = example(train=[ID_EXAMPLE], val=[], test=[], reason="first release")

    reason: Reason


class Sizes(Answer):
    """How many sequences are in each part."""

    model_config = example(train=31, val=7, test=5)

    train: int
    val: int
    test: int


class SizesAsked(Body):
    """How many sequences each part is to have."""

    model_config = example(train=31, val=7, test=5)

    train: Size
    val: Size
    test: Size


class ProposalBody(Body):
    """What is to be proposed, of all labelled sequences but those to leave out."""

    model_config = example(sizes={"train": 1, "val": 0, "test": 0}, leave_out=[])

    sizes: SizesAsked
    leave_out: Ids = Field(default_factory=list)


class RuleItem(Answer):
    """What a rule says: broken (`error`), or not to be kept with these data (`warning`)."""

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


class VerdictsAnswer(Answer):
    """What the rules say of splits; `revision` is that of the splits that stand meanwhile."""

    model_config = example(revision=4, can_be_put=True)

    revision: int
    can_be_put: bool
    findings: list[RuleItem]


class DrivenItem(QualityFields):
    """Where and when a sequence was driven, and how much of it there is; null is what nobody counted."""

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
    """A labelled sequence as the dataset sees it."""

    model_config = example()

    sequence_id: str
    voxels: VoxelsItem | None


class SplitsAnswer(Answer):
    """The splits under discussion: all sizes, and of the sequences those the caller may see.

    `findings` are of the whole and null for whoever does not see the whole.
    """

    model_config = example(
        revision=4,
        sizes={"train": 1, "val": 0, "test": 0},
        val=[],
        test=[],
        unassigned=[],
        findings=[example_of(RuleItem)],
    )

    revision: int
    sizes: Sizes
    train: list[SplitEntry]
    val: list[SplitEntry]
    test: list[SplitEntry]
    unassigned: list[SplitEntry]
    findings: list[RuleItem] | None


class SharesItem(Answer):
    """What a part holds of the assigned seconds, and of which classes its occupied voxels are (null: not known)."""

    model_config = example(
        sequences=31,
        duration_ratio=0.72,
        class_ratios={"traversable": 0.18, "potentially_traversable": 0.26, "non_traversable": 0.56},
    )

    sequences: int
    duration_ratio: float
    class_ratios: VoxelRatios | None


class Shares(Answer):
    """Of the whole and of each part."""

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
    shares: Shares
