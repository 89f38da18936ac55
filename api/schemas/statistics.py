"""Dataset statistics over the wire: the record of `services/domain/datasets/statistics.py`."""

from api.schemas.base import Answer, example, example_of
from api.schemas.class_counts import ClassCounts
from api.schemas.quality import QualityFields


class VoxelRatios(Answer):
    """Shares of the occupied voxels."""

    traversable: float
    potentially_traversable: float
    non_traversable: float


class TallyItem(QualityFields):
    """Sums over several sequences; sequences that continue each other count as one of the `drives`.

    Null values are unknown or not shown for all of them. The held-out recall is that of all judged metres together;
    `held_out_known` sequences have one. `gravest` is the most harmful finding of any sequence.
    """

    model_config = example(
        sequences=12,
        drives=12,
        frames=14400,
        duration_s=1440.0,
        distance_m=1820.5,
        distances_known=12,
        class_ratios={"traversable": 0.178, "potentially_traversable": 0.261, "non_traversable": 0.561},
        voxels_known=12,
        held_out_known=11,
    )

    sequences: int
    drives: int
    frames: int
    duration_s: float
    distance_m: float | None
    distances_known: int
    voxels: ClassCounts | None
    class_ratios: VoxelRatios | None
    voxels_known: int
    held_out_known: int


class KeyTally(TallyItem):
    """The sums over sequences with this word; '' is unspecified, or unassigned."""

    model_config = example(key="lake")

    key: str


class CellTally(TallyItem):
    """The sums over one environment in one illumination."""

    model_config = example(environment="lake", illumination="dusk")

    environment: str
    illumination: str


class StatisticsAnswer(Answer):
    """The composition of a version of the dataset (`dataset`), or of the labelled sequences the caller may see (null).

    For a version, voxels are those of train and val; test is not included.
    """

    model_config = example(
        dataset="stone-1.0",
        parts=[example_of(KeyTally) | {"key": "train"}],
        illuminations=[example_of(KeyTally) | {"key": "dusk"}],
        halves=[example_of(KeyTally) | {"key": "day"}],
        regions=[example_of(KeyTally) | {"key": "Gyeonggi"}],
    )

    dataset: str | None
    total: TallyItem
    parts: list[KeyTally]
    environments: list[KeyTally]
    illuminations: list[KeyTally]
    halves: list[KeyTally]
    regions: list[KeyTally]
    cells: list[CellTally]
