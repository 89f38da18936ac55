"""The metrics of the benchmark: their versions, their ratios, and the text that defines each of them.

**Conventions.** A version is never changed: another rule is another version, and a board shows one at a time. The
definitions are plain Markdown for people; `confusion.ratios` computes what they say, golden vectors prove it.
This module loads nothing, so that every process may.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from stone.errors import StoneError

CLASS_NAMES = ("free", "T", "P", "N")
CLASSES = len(CLASS_NAMES)
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")
METRIC_VERSION = "stone-iou-1"
OCCUPIED_VERSION = "stone-iou-occupied-1"


class UnknownMetricError(StoneError):
    """No metric has this version."""

    code = "unknown_metric"

    def __init__(self, version: str) -> None:
        known = ", ".join(METRICS)
        super().__init__(f"there is no metric {version[:64]!r}; there are {known} (was it named from memory?)")


@dataclass(frozen=True)
class Metric:
    """One way to read ratios from confusions; `definition` is Markdown."""

    version: str
    title: str
    definition: str


def metric_of(version: str) -> Metric:
    """Raises `UnknownMetricError`."""
    if version not in METRICS:
        raise UnknownMetricError(version)
    return METRICS[version]


_COUNTED = """\
## What is counted

- A frame is a grid of 256 × 256 × 32 voxels of 0.2 m over [−25.6, 25.6) × [−25.6, 25.6) × [−2.0, 4.4) m in the frame
  of the robot (x forward, y left, z up), C order, uint8. Classes: 0 free, 1 traversable (T), 2 potentially traversable
  (P), 3 non-traversable (N). *Occupied* means T, P or N. There is no class "unknown": a prediction that holds any other
  value (255, say) anywhere, evaluated or not, is refused as `label_out_of_range` and not scored.
- A voxel is *evaluated* by the mask of the phase: `all` – every voxel, so that the ground truth's 0 means free or never
  seen; `lidar` – where `mask_lidar` of the ground truth is not 0; `camera` – where `mask_camera` is not 0. Masks belong
  to the ground truth alone. A voxel that is not evaluated counts nowhere.
- Per frame, and per ring of horizontal distance of the voxel's centre from the robot (0–10, 10–20, from 20 m,
  half-open), evaluated voxels are counted in a 4 × 4 confusion: rows ground truth, columns prediction, in the order of
  the classes.
- Confusions of all frames, of all sequences, are added first, as integers; ratios are read once, from the sum. No ratio
  is ever averaged over frames, rings or sequences.
"""

_RULES = """\
    mIoU    = (IoU_T + IoU_P + IoU_N) / 3

*Free is not in the mean*: the confusion counts it, so that a class predicted into free space can cost that class, but
there is no IoU of free space in mIoU or anywhere else.

## What is undefined

A ratio whose union holds no voxel – the class is neither in the ground truth nor in the prediction – is undefined:
`null`, never 0 and never 1, and it is shown with its support (the voxels of the class in the ground truth). An mIoU
with an undefined part is `null` too, for a mean of two classes is not comparable with one of three. A class that is
absent from the ground truth but predicted there has IoU 0. A submission whose mIoU is `null` has no rank.

## Ties

Entries are ordered by mIoU, then IoU_occ, then IoU_N, each rounded to four digits, then by the time of finalisation,
earlier first; equal rounded values share a rank. Ranks come with an interval from paired block resampling (blocks of
200 frames inside sequences, circular), since neighbouring frames are no independent samples.
"""

_OTHERS = """\
## Shown beside it, never ranked

    N predicted T = |truth N ∧ predicted T| / |truth N|       (danger)
    T predicted N = |truth T ∧ predicted N| / |truth T|       (over-caution)
    drivable IoU  = columns drivable in both / columns drivable in either

A column (the 32 voxels above one another) is drivable where its evaluated voxels hold a T or P and no N. Each is `null`
where its denominator is 0.
"""


def _definition(title: str, reading: str) -> str:
    return "\n".join((f"# {title}\n", _COUNTED, f"## The ratios\n\n{reading}{_RULES}", _OTHERS))


_EVERYWHERE = """\
Over all evaluated voxels:

    IoU_occ = |truth occupied ∧ predicted occupied| / |truth occupied ∨ predicted occupied|
    IoU_c   = |truth c ∧ predicted c| / |truth c ∨ predicted c|,  c ∈ {T, P, N}
"""

_OCCUPIED_ONLY = """\
IoU_occ over all evaluated voxels; the classes over those evaluated voxels that the ground truth calls occupied, so that
what is predicted into the ground truth's free space costs IoU_occ and no class:

    IoU_occ = |truth occupied ∧ predicted occupied| / |truth occupied ∨ predicted occupied|
    IoU_c   = |truth c ∧ predicted c| / |truth occupied ∧ (truth c ∨ predicted c)|,  c ∈ {T, P, N}
"""


def _metric(version: str, title: str, reading: str) -> Metric:
    return Metric(version, title, _definition(f"{version}: {title}", reading))


METRICS: Mapping[str, Metric] = {
    metric.version: metric
    for metric in (
        _metric(METRIC_VERSION, "IoU over all evaluated voxels", _EVERYWHERE),
        _metric(OCCUPIED_VERSION, "IoU of classes within occupied ground truth", _OCCUPIED_ONLY),
    )
}
