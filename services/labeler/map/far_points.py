"""Counts of impossibly far and untimed points in the sweeps of a run."""

from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from services.labeler.run import LabelRun, Part, parts_of
from services.labeler.scratch import load, save
from stone.findings import Finding
from stone.sensors.reach import FARTHEST_POINT_M
from stone.sensors.sequence import Sequence, Sweep

FAR = "far"


@dataclass(frozen=True)
class FarPoints:
    """`points` excluded from `sweeps` of `read` sweeps; the counts of parts add up.

    `mistimed` points in `mistimed_sweeps` have times outside their sweep; `untimed_sweeps` have no times at all.
    """

    points: int = 0
    sweeps: int = 0
    read: int = 0
    mistimed: int = 0
    mistimed_sweeps: int = 0
    untimed_sweeps: int = 0

    def __add__(self, other: "FarPoints") -> "FarPoints":
        return FarPoints(*(own + another for own, another in zip(astuple(self), astuple(other), strict=True)))


def far_points_of(sweep: Sweep) -> FarPoints:
    mistimed = (sweep.mistimed, int(sweep.mistimed > 0), int(not sweep.is_timed))
    return FarPoints(sweep.beyond, int(sweep.beyond > 0), 1, *mistimed)


def far_points_path(run: LabelRun, part: Part) -> Path:
    return run.scratch / FAR / f"{part[0]:06d}.npz"


def save_far_points(run: LabelRun, part: Part, counted: FarPoints) -> None:
    save(far_points_path(run, part), {"counts": np.array(astuple(counted), np.int64)})


def load_far_points(run: LabelRun) -> FarPoints:
    """Return the sum over all parts of the run."""
    counts = (load(far_points_path(run, part))["counts"].tolist() for part in parts_of(run))
    return sum((FarPoints(*row) for row in counts), FarPoints())


def far_point_findings(far: FarPoints) -> tuple[Finding, ...]:
    """Return LAB-608 if points were excluded."""
    if not far.points:
        return ()
    sentence = (
        f"{far.points} points in {far.sweeps} of {far.read} sweeps are farther than {FARTHEST_POINT_M:g} m from "
        "the LiDAR, beyond any LiDAR's range, and are excluded. Does the driver write a number for missing returns, "
        "are the points in millimetres, or is the recording damaged?"
    )
    return (Finding("LAB-608", "warning", "", sentence),)


def time_findings(far: FarPoints, sequence: Sequence) -> tuple[Finding, ...]:
    """Return MSG-321 and MSG-322 for bad times in sweeps that synchronisation did not read."""
    topic = sequence.frames.sweeps.topic if sequence.frames.sweeps else ""
    known = {finding.code for finding in sequence.findings}
    counts = (
        ("MSG-321", far.mistimed, f"{far.mistimed} points in {far.mistimed_sweeps}", "have bad times"),
        ("MSG-322", far.untimed_sweeps % max(far.read, 1), f"{far.untimed_sweeps}", "are not deskewed"),
    )
    return tuple(
        Finding(code, "warning", topic, f"{shown} of {far.read} fused sweeps {what}: their times cannot be read")
        for code, count, shown, what in counts
        if count and code not in known
    )
