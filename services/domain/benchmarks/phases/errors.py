"""Errors of creating and changing benchmarks and phases."""

from stone.errors import Refused


def no_ground_truth(phase: str) -> Refused:
    return Refused(
        "no_ground_truth",
        f"phase {phase!r} has no ground truth yet; an administrator must create the ground truth from a dataset "
        "version",
    )
