"""The results of inspecting and labelling a faulty drive, and the difference of its labels from the sound labels.

**Conventions.** Everything follows the paths of `stone inspect` and `stone label`. Labels are compared in the frames
common to both runs, by stamp, in the frame of the robot: moving a track as a whole changes nothing.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.domain.sequences.label_choices import DEFAULT_PROFILE
from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.ingest.sandboxed_inspection import outlook, with_new
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from services.labeler.report import LabelReport
from stone.errors import StoneError
from stone.findings import Finding
from stone.labels.voxels import VOXEL_M
from stone.sensors.calibration import Calibration
from stone.sensors.ground_plane import BAND_M
from stone.sensors.sequence import Sequence
from stone_base.label_grid import PAPER
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.inspection import inspect_in
from testing.worlds.faults.drive import SoundDrive, faulty
from testing.worlds.faults.fault import RecordingFault

NAME = "run"
SLACK_M = 0.35 + 0.25  # a voxel's diagonal, half a step of the track
EVERY_FRAME = 5


@dataclass(frozen=True, eq=False)
class LabelledDrive:
    """The labels: report, and the classes of a few frames by stamp."""

    report: LabelReport
    grids: Mapping[int, NDArray[np.uint8]]


@dataclass(frozen=True)
class FaultOutcome:
    """`named` are the codes of inspection's findings, `errors` those of errors; `refusal` is labelling's code or "".

    `excluded` counts the frames left out by reason, `beyond` the T voxels beyond the footprint of any pose. `p_share`
    is P's share of the occupied voxels, and `agreement` the share of voxels classed as in the sound run.
    """

    fault: str
    drive: str
    named: tuple[str, ...]
    errors: tuple[str, ...] = ()
    refusal: str = ""
    sentence: str = ""
    frames: int = 0
    excluded: Mapping[str, int] = field(default_factory=dict)
    found: tuple[str, ...] = ()
    beyond: int = 0
    driven: int = 0
    p_share: float = 0.0
    agreement: float = 0.0

    def as_record(self) -> dict[str, Any]:
        return {**vars(self), "excluded": dict(self.excluded)}


def sound(drive: SoundDrive, folder: Path) -> LabelledDrive:
    """Return the drive's labels without a fault."""
    return labelled(drive.bag, drive.rig(), folder, SynchroniseOptions())


def outcome(
    drive: SoundDrive, fault: RecordingFault, folder: Path, clean: Mapping[int, NDArray[np.uint8]]
) -> FaultOutcome:
    """Return the outcome of a fault; `clean` are the grids of the sound run, by stamp.

    Raises any error that is not a refusal: a crash without a code is no outcome.
    """
    bag, rig = faulty(drive, fault, folder / "run.mcap"), drive.rig(fault)
    try:
        seen = inspected(bag, rig)
    except StoneError as refusal:
        seen = (Finding(refusal.code, "error", "", str(refusal)),)
    named, errors = codes(seen), codes(tuple(finding for finding in seen if finding.severity == "error"))
    try:
        made = labelled(bag, rig, folder / "labels", SynchroniseOptions())
    except StoneError as refusal:
        return FaultOutcome(fault.name, drive.name, named, errors, refusal.code, str(refusal))
    report = made.report
    gaps_m = driven_off_track_m(report.sequence, made.grids)
    return FaultOutcome(
        fault.name,
        drive.name,
        named,
        errors,
        frames=len(report.sequence.frames),
        excluded=Counter(frame.code for frame in report.sequence.excluded),
        found=codes(report.findings),
        beyond=int((gaps_m > reach_m(rig)).sum()),
        driven=len(gaps_m),
        p_share=report.class_shares()["potentially_traversable"],
        agreement=agreement(made.grids, clean),
    )


def inspected(bag: Path, rig: Calibration) -> tuple[Finding, ...]:
    """Return the findings before labelling."""
    with open_bag(bag) as opened:
        known = inspect_in(opened).findings
        return with_new(known, outlook(opened, rig, SynchroniseOptions()))


def codes(findings: tuple[Finding, ...]) -> tuple[str, ...]:
    return tuple(sorted({finding.code for finding in findings if finding.severity != "info"}))


def reach_m(rig: Calibration) -> float:
    """Return the largest distance of a driven voxel from a pose."""
    return float(np.hypot(rig.footprint.length_m, rig.footprint.width_m) / 2 + BAND_M + SLACK_M)


def driven_off_track_m(sequence: Sequence, grids: Mapping[int, NDArray[np.uint8]]) -> NDArray[np.float64]:
    """Return the distance of every T voxel from the nearest pose of the track."""
    assert sequence.track is not None
    poses_m = sequence.track.map_from_ego.translation_m
    rows = {stamp_ns: row for row, stamp_ns in enumerate(sequence.frames.stamps_ns.tolist())}
    distances = [np.zeros(0)]
    for stamp_ns, grid in grids.items():
        ego_m = (np.argwhere(grid == 1) * VOXEL_M + PAPER.min_m + VOXEL_M / 2).astype(np.float64)
        driven_m = sequence.frames.map_from_ego[rows[stamp_ns]] @ ego_m
        distances.append(np.linalg.norm(driven_m[:, None] - poses_m, axis=2).min(axis=1))
    return np.concatenate(distances)


def agreement(ours: Mapping[int, NDArray[np.uint8]], theirs: Mapping[int, NDArray[np.uint8]]) -> float:
    """Return the share classed alike among voxels occupied in either; NaN without a common frame."""
    alike = total = 0
    for stamp_ns in ours.keys() & theirs.keys():
        is_occupied = (ours[stamp_ns] > 0) | (theirs[stamp_ns] > 0)
        alike += int((ours[stamp_ns] == theirs[stamp_ns])[is_occupied].sum())
        total += int(is_occupied.sum())
    return alike / total if total else float("nan")


def labelled(bag: Path, rig: Calibration, folder: Path, options: SynchroniseOptions) -> LabelledDrive:
    """Return the labels of a recording by the default profile. Raises the refusal if there are none."""
    sequence, sweeps = synchronise(bag, rig, options, NAME)
    report = label(sequence, sweeps, folder, LabelOptions(parameters_for(DEFAULT_PROFILE)))
    frames = report.sequence.frames
    picked = [row for row, stamp_ns in enumerate(frames.stamps_ns.tolist()) if _is_picked(stamp_ns)]
    grids = {int(frames.stamps_ns[row]): _grid(folder, frames.tokens[row]) for row in picked}
    return LabelledDrive(report, grids)


def _is_picked(stamp_ns: int) -> bool:
    """Return whether a frame is selected, by its stamp, so that two runs select the same frames."""
    return round(stamp_ns / 1e8) % EVERY_FRAME == 0


def _grid(folder: Path, token: str) -> NDArray[np.uint8]:
    grid: NDArray[np.uint8] = np.load(folder / "gts" / NAME / token / "labels.npz")["semantics"]
    return grid
