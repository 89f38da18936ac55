"""The metrics of the benchmark: their versions, their ratios, and the text that defines each of them.

**Conventions.** A version is never changed: another rule is another version, and a board shows one at a time. The
definitions are plain Markdown for people; `confusion.ratios` computes what they say, golden vectors prove it. The
versions `-1` have the same ratios as those that follow them, and intervals that claimed more than was known: of their
scores no interval, tie or rank interval is told any more, and nothing is scored anew by them.
This module loads nothing, so that every process may.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from stone.errors import Refused

CLASS_NAMES = ("free", "T", "P", "N")
CLASSES = len(CLASS_NAMES)
RATIOS = ("iou_occ", "iou_t", "iou_p", "iou_n", "miou")
METRIC_VERSION = "stone-iou-2"
OCCUPIED_VERSION = "stone-iou-occupied-2"


def unknown_metric(version: str) -> Refused:
    known = ", ".join(METRICS)
    return Refused("unknown_metric", f"there is no metric {version[:64]!r}; there are {known} (misspelt?)")


@dataclass(frozen=True)
class Metric:
    """One way to read ratios from confusions; `definition` is Markdown.

    `is_within_occupied` restricts classes to voxels that the ground truth calls occupied. `successor` has the same
    ratios and intervals that hold; None of a version that is current.
    """

    version: str
    title: str
    definition: str
    is_within_occupied: bool
    successor: str | None = None


def current_metric(version: str) -> Metric:
    """The metric, if scores are made by it. Raises `unknown_metric`, `superseded_metric`."""
    metric = metric_of(version)
    if metric.successor is not None:
        raise Refused(
            "superseded_metric",
            f"by {metric.version!r} nothing is scored any more, since its intervals are withdrawn; its ratios are "
            f"those of {metric.successor!r}, which is what to name",
        )
    return metric


def metric_of(version: str) -> Metric:
    """Raises `unknown_metric`."""
    if version not in METRICS:
        raise unknown_metric(version)
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
earlier first; equal rounded values share a rank."""

_BLOCK_RESAMPLING = """\
 Ranks come with an interval from paired block resampling (blocks of
200 frames inside sequences, circular), since neighbouring frames are no independent samples.
"""

_SPECTRAL_INTERVALS = """\


## Intervals

An interval of 95 % is told where it can be held, and elsewhere the reason why it is not: neighbouring frames see the
same ground, and how alike they are is measured. *These places*: the variance of a ratio, and of a difference of two, is
estimated from the slow cosine coefficients of its frames' influences in each sequence, with critical values of
Student's t; it takes five of them below the frequency of the correlation time that is allowed for. *A new place*: the
variance over whole sequences, five or more. A rank's interval and the tie groups follow from all pairs of the board at
once (Tukey): that any two equal entries of a board are told apart has a chance of 5 % or less.
"""

_OTHERS_AT_FIRST = """\
## Shown beside it, never ranked

    N predicted T = |truth N ∧ predicted T| / |truth N|       (danger)
    T predicted N = |truth T ∧ predicted N| / |truth T|       (over-caution)
    drivable IoU  = columns drivable in both / columns drivable in either

A column (the 32 voxels above one another) is drivable where its evaluated voxels hold a T or P and no N. Each is `null`
where its denominator is 0.
"""

_OTHERS = """\
## Shown beside it, never ranked

    N predicted T or P = |truth N ∧ predicted T or P| / |truth N|  (danger: planners drive on P too)
    N predicted T      = |truth N ∧ predicted T| / |truth N|       (the worst part of it)
    T predicted N      = |truth T ∧ predicted N| / |truth T|       (over-caution)
    drivable IoU       = columns drivable in both / columns drivable in either

A column (the 32 voxels above one another) is drivable where its evaluated voxels hold a T or P and no N. Each is `null`
where its denominator is 0.

Labels are sheets of one voxel, so a surface that is right to a few centimetres may fall into the next voxel. Two
readings forgive that, of at most 250 frames of a submission: the first and every n-th after it, n = ⌈frames / 250⌉.

- *±1 voxel*: IoU = pairs / (voxels of the truth + voxels of the prediction − pairs), of occupied voxels and of each
  class. The pairs of a column are the voxels of the truth with a voxel of the prediction at most one voxel above or
  below, or the voxels of the prediction with one of the truth, whichever are fewer. Only evaluated voxels take part.
- *Columns*: each column counts once, and the ratios are those of the confusion of columns. The class of a column is
  the worst of its evaluated voxels: N before P before T, free without any. An N does not count if at least 1.6 m,
  eight voxels, are between it and the lowest T or P of the column: the robot drives under it. *Clear drivable IoU*:
  columns of class T or P in both / in either.
"""


def _definition(title: str, reading: str, intervals: str, others: str) -> str:
    return "\n".join((f"# {title}\n", _COUNTED, f"## The ratios\n\n{reading}{_RULES}{intervals}", others))


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


def _versions(name: str, title: str, reading: str, is_within_occupied: bool) -> tuple[Metric, Metric]:
    """The current version, and the one before it."""
    (old, old_text), (new, new_text) = (
        (version, _definition(f"{version}: {title}", reading, *parts))
        for version, *parts in (
            (f"{name}-1", _BLOCK_RESAMPLING, _OTHERS_AT_FIRST),
            (f"{name}-2", _SPECTRAL_INTERVALS, _OTHERS),
        )
    )
    return Metric(new, title, new_text, is_within_occupied), Metric(old, title, old_text, is_within_occupied, new)


METRICS: Mapping[str, Metric] = {
    metric.version: metric
    for versions in (
        _versions("stone-iou", "IoU over all evaluated voxels", _EVERYWHERE, False),
        _versions("stone-iou-occupied", "IoU of classes within occupied ground truth", _OCCUPIED_ONLY, True),
    )
    for metric in versions
}
