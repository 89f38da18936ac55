"""Label sets over the wire, and comparisons of two of them."""

from api.schemas.base import ID_EXAMPLE, Answer, Body, IdText, Instant, example, example_of
from api.schemas.grids import GridItem
from api.schemas.jobs import FailureItem, JobItem
from api.schemas.quality import QualityFields

OTHER_EXAMPLE = "019aa5b0c1d24f6e8a7b3c5d9e0f1a2c"
RATIOS_EXAMPLE = {"iou_occ": 0.971, "iou_t": 0.94, "iou_p": 0.88, "iou_n": 0.96, "miou": 0.927}
CONFUSION_EXAMPLE = [[2040000, 900, 300, 1200], [700, 21000, 400, 10], [350, 380, 9000, 200], [900, 15, 260, 21537]]


class LabelSetItem(QualityFields):
    """A label set of a sequence; the one requested last is active."""

    model_config = example(
        profile="field",
        frames=1200,
        code_version="71299b6a455d",
        is_counting=True,
        created_at="2026-05-03T10:31:02.250000Z",
    )

    id: str
    profile: str
    frames: int
    code_version: str
    is_counting: bool
    grid: GridItem
    created_at: Instant


class NewLabelComparisonBody(Body):
    """Which two label sets of the sequence are to be compared; neither is the truth."""

    model_config = example(a_id=ID_EXAMPLE, b_id=OTHER_EXAMPLE)

    a_id: IdText
    b_id: IdText


class AgreementFigures(Answer):
    """Voxels by class in A (rows) and B (columns), and what is read from them; null where undefined."""

    model_config = example(confusion=CONFUSION_EXAMPLE, agreement_ratio=0.902, ratios=RATIOS_EXAMPLE)

    confusion: list[list[int]]
    agreement_ratio: float | None
    ratios: dict[str, float | None]


class AgreementRing(AgreementFigures):
    """The same of voxels whose columns are so far from the robot; the last ring has no end."""

    model_config = example(from_m=0.0, to_m=10.0)

    from_m: float
    to_m: float | None


class AgreementBlock(AgreementFigures):
    """The figures of all rings together, and of each."""

    model_config = example()

    rings: list[AgreementRing]


class SeenVoxels(Answer):
    """Voxels that a ray reached or passed: in both label sets, in A only, in B only."""

    model_config = example(both=512000, only_a=1200, only_b=800)

    both: int
    only_a: int
    only_b: int


class FrameAgreement(Answer):
    """Agreement of the labels of a frame; its token is that in A."""

    model_config = example(token=ID_EXAMPLE, agreement_ratio=0.902)

    token: str
    agreement_ratio: float


class AgreementRecord(Answer):
    """Agreement of two label sets; `seen_in_both` is null if one of them has no masks."""

    model_config = example(frames=1, only_in_a=0, only_in_b=0, has_equal_classes=False)

    frames: int
    only_in_a: int
    only_in_b: int
    has_equal_classes: bool
    all_voxels: AgreementBlock
    seen_in_both: AgreementBlock | None
    seen_voxels: SeenVoxels | None
    least_alike: list[FrameAgreement]


class LabelComparisonItem(Answer):
    """A comparison of two label sets; its record is there once its state is `succeeded`."""

    model_config = example(
        b_id=OTHER_EXAMPLE,
        state="succeeded",
        code_version="71299b6a455d",
        failure=None,
        created_at="2026-05-03T10:31:02.250000Z",
        finished_at="2026-05-03T10:31:08Z",
    )

    id: str
    sequence_id: str
    a_id: str
    b_id: str
    job_id: str
    state: str
    code_version: str
    record: AgreementRecord | None
    failure: FailureItem | None
    created_at: Instant
    finished_at: Instant | None


class LabelComparisonAccepted(Answer):
    """The requested comparison, and the job that makes it or has made it."""

    model_config = example(job=example_of(JobItem) | {"kind": "eval.compare"})

    comparison: LabelComparisonItem
    job: JobItem
