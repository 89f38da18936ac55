"""The array `confidence` of `labels.npz`: the probability that a voxel's label is right, times 255; 0 if it is free."""

from math import ceil

from stone_base.errors import Refused

CERTAIN = 255


def least_level(least_confidence: float) -> int:
    """Return the lowest value of the array that stands for at least this probability (0 to 1)."""
    return ceil(CERTAIN * least_confidence)


def no_confidence(name: object) -> Refused:
    return Refused(
        "no_confidence",
        f"{name} has no array confidence, which --least-confidence requires; label the run again with `stone "
        "label --confidence` (profile field), or omit the option",
    )
