"""The metrics of the benchmark: their versions, their ratios, and the text that defines each version.

**Conventions.** A version never changes: a changed rule is a new version, and a board shows one version at a time. The
definitions are plain Markdown for people; `confusion.ratios` computes them, and test vectors prove that. The versions
`-1` have the same ratios as their successors, but their intervals were too narrow. Their scores have no intervals, ties
or rank intervals, and they cannot be used for new scores. This module loads nothing, so every process may import it.
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
    return Refused("unknown_metric", f"unknown metric {version[:64]!r}; choose one of {known} (misspelt?)")


@dataclass(frozen=True)
class Metric:
    """A rule to compute ratios from confusion matrices; `definition` is Markdown.

    `is_within_occupied` restricts classes to voxels that are occupied in the ground truth. `successor` has the same
    ratios and valid intervals; None for a current version.
    """

    version: str
    title: str
    definition: str
    is_within_occupied: bool
    successor: str | None = None


def current_metric(version: str) -> Metric:
    """Return the metric if it can be used for new scores. Raises `unknown_metric`, `superseded_metric`."""
    metric = metric_of(version)
    if metric.successor is not None:
        raise Refused(
            "superseded_metric",
            f"metric {metric.version!r} is superseded because its intervals were withdrawn; use "
            f"{metric.successor!r}, which has the same ratios",
        )
    return metric


def metric_of(version: str) -> Metric:
    """Return the metric of this version. Raises `unknown_metric`."""
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

A 95 % interval is given if it is reliable; otherwise the reason is given. Neighbouring frames overlap, so their
correlation is estimated. *These places*: the variance of a ratio (or of a difference of two) is estimated from the
low-frequency cosine coefficients of its frames' influences in each sequence. Critical values are those of Student's t.
At least five coefficients below the frequency of the assumed correlation time are required. *Unseen places*: the
variance over at least five whole sequences. Rank intervals and tie groups compare all pairs of the board jointly
(Tukey): the family-wise error rate is at most 5 %.
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

A column (32 voxels, one above the other) is drivable if its evaluated voxels contain a T or P and no N. A ratio is
`null` if its denominator is 0.

Labelled surfaces are one voxel thick, so a surface with an error of a few centimetres may fall into the next voxel. Two
ratios tolerate this. They use at most 250 frames of a submission: the first and every n-th, n = ⌈frames / 250⌉.

- *±1 voxel*: IoU = pairs / (truth voxels + predicted voxels − pairs), for occupied voxels and for each class. In each
  column, count the truth voxels with a predicted voxel at most one voxel above or below, and the predicted voxels with
  such a truth voxel; the smaller count is the number of pairs. Only evaluated voxels count.
- *Columns*: each column counts once in a confusion matrix of columns. The class of a column is the worst class of its
  evaluated voxels: N before P before T, or free if none is occupied. An N does not count if at least 1.6 m (8 voxels)
  lie between it and the lowest T or P of the column, because the robot drives under it. *Clear drivable IoU*: columns
  of class T or P in both / in either.
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
    """Return the current version and the superseded one."""
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
