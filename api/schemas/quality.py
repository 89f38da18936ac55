"""The quality of labels over the wire (`stone_base/label_quality.py`)."""

from api.schemas.base import Answer, example
from stone_base.codes.meaning import Harm


class GravestItem(Answer):
    """The finding that harms the labels most; its code has a page at `/codes/{code}`."""

    model_config = example(code="LAB-605", harm="wrong")

    code: str
    harm: Harm


class QualityFields(Answer):
    """Quality of labels where the robot drove; null if it was not measured, or is not shown.

    `held_out_recall` is the share of driven ground that labels made from the other half of the track call T or P, over
    `held_out_m` metres. `gravest` is null if no finding harms the labels.
    """

    model_config = example(held_out_recall=0.9731, held_out_m=75.4)

    held_out_recall: float | None
    held_out_m: float | None
    gravest: GravestItem | None
