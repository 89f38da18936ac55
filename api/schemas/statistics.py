"""Dataset statistics over the wire: the record of `services/domain/datasets/statistics.py`."""

from typing import Any

from api.schemas.base import Answer, example

VOXELS_EXAMPLE = {"traversable": 1842003, "potentially_traversable": 2700114, "non_traversable": 5811201}
TALLY_EXAMPLE: dict[str, Any] = {
    "sequences": 12,
    "frames": 14400,
    "duration_s": 1440.0,
    "distance_m": 1820.5,
    "distances_known": 12,
    "voxels": VOXELS_EXAMPLE,
    "class_ratios": {"traversable": 0.178, "potentially_traversable": 0.261, "non_traversable": 0.561},
    "voxels_known": 12,
}


class VoxelsItem(Answer):
    """Labelled voxels of all frames by class."""

    model_config = example(**VOXELS_EXAMPLE)

    traversable: int
    potentially_traversable: int
    non_traversable: int


class VoxelRatios(Answer):
    """Of the occupied voxels."""

    traversable: float
    potentially_traversable: float
    non_traversable: float


class TallyItem(Answer):
    """Sums over some sequences; null is what is not known, or not told, of any of them."""

    model_config = example(**TALLY_EXAMPLE)

    sequences: int
    frames: int
    duration_s: float
    distance_m: float | None
    distances_known: int
    voxels: VoxelsItem | None
    class_ratios: VoxelRatios | None
    voxels_known: int


class KeyTally(TallyItem):
    """Of the sequences with this word; '' is unspecified, or unassigned."""

    model_config = example(key="lake", **TALLY_EXAMPLE)

    key: str


class CellTally(TallyItem):
    """Of one environment in one illumination."""

    model_config = example(environment="lake", illumination="dusk", **TALLY_EXAMPLE)

    environment: str
    illumination: str


class StatisticsAnswer(Answer):
    """The composition of a version of the dataset (`dataset`), or of the labelled sequences the caller may see (null).

    Of a version, voxels are those of train and val: of test none are told.
    """

    model_config = example(
        dataset="stone-1.0",
        total=TALLY_EXAMPLE,
        parts=[{"key": "train", **TALLY_EXAMPLE}],
        environments=[{"key": "lake", **TALLY_EXAMPLE}],
        illuminations=[{"key": "dusk", **TALLY_EXAMPLE}],
        halves=[{"key": "day", **TALLY_EXAMPLE}],
        regions=[{"key": "Gyeonggi", **TALLY_EXAMPLE}],
        cells=[{"environment": "lake", "illumination": "dusk", **TALLY_EXAMPLE}],
    )

    dataset: str | None
    total: TallyItem
    parts: list[KeyTally]
    environments: list[KeyTally]
    illuminations: list[KeyTally]
    halves: list[KeyTally]
    regions: list[KeyTally]
    cells: list[CellTally]
