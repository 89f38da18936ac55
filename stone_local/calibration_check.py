"""Checks of a calibration file before labelling: the file alone, and against a recording.

**Conventions.** The file is read as ingest reads it. With a recording, the run is synchronised as for labels, so that
the ground and the cameras are measured by the same code. Only the findings about calibrations (`CAL-*`, and cameras
that miss their phase, `TIM-205`) are kept; `stone inspect` reports the others. A recording without a LiDAR or without
poses is no fault of the calibration: a warning then states that nothing was measured. Any other reason that prevents
synchronisation also prevents labelling, and is an error.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import sequence_in
from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.calibration_errors import MissingSensorError
from stone.sensors.ground_plane import GroundFit
from stone.sensors.ground_refusals import ground_refusal
from stone_files.recording_name import sequence_name
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.calibrations.file import CalibrationRead, read_any_calibration
from stone_recordings.report.rig.channels import ChannelMatch, channel_findings, channel_matches
from stone_recordings.report.rig.record import calibration_facts
from stone_recordings.topics.profiles import TopicProfile

WITHOUT_A_RUN = ("TOP-101", "SYN-501", "SYN-502", "SYN-503")
"""The codes of a recording that cannot be synchronised."""
OF_CALIBRATIONS = ("CAL-", "TIM-205")


@dataclass(frozen=True)
class BagChoice:
    """The recording to check against, with topics for its ambiguous roles."""

    bag: Path
    profile: TopicProfile = field(default_factory=TopicProfile)
    options: SynchroniseOptions = field(default_factory=SynchroniseOptions)


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """The result of a check; `channels` and `ground` are of the recording, None without one."""

    read: CalibrationRead
    findings: tuple[Finding, ...]
    channels: tuple[ChannelMatch, ...] | None = None
    ground: GroundFit | None = None

    @property
    def is_usable(self) -> bool:
        return all(finding.severity != "error" for finding in self.findings)

    def as_record(self) -> dict[str, Any]:
        return {
            **calibration_facts(self.read),
            "is_usable": self.is_usable,
            "channels": None if self.channels is None else [match.as_record() for match in self.channels],
            "ground": None if self.ground is None else ground_record(self.ground),
            "findings": [finding.as_record() for finding in self.findings],
        }


def check_calibration_file(path: Path, choice: BagChoice | None = None) -> CalibrationCheck:
    """Return the check of a calibration file. Raises as `read_any_calibration` does, and as opening and inspecting the
    recording do.
    """
    read = read_any_calibration(path)
    if choice is None:
        return CalibrationCheck(read, read.findings)
    with open_bag(choice.bag) as bag:
        channels = channel_matches(bag, read.calibration, choice.profile)
        measured, ground = _on_the_run(bag, path, choice.options)
    findings = (*read.findings, *channel_findings(channels, read.calibration), *measured)
    return CalibrationCheck(read, tuple(dict.fromkeys(findings)), channels, ground)


def ground_record(ground: GroundFit) -> Mapping[str, float | int]:
    """Return the position of the ground in the ego frame."""
    return {
        "height_m": round(ground.height_m, 4),
        "tilt_deg": round(float(np.rad2deg(ground.tilt_rad)), 3),
        "low_m": round(ground.low_m, 4),
        "high_m": round(ground.high_m, 4),
        "sweeps": ground.sweeps,
    }


def _on_the_run(bag: Bag, path: Path, options: SynchroniseOptions) -> tuple[tuple[Finding, ...], GroundFit | None]:
    """Return the findings of synchronising the run that concern the calibration, and the ground if it was measured."""
    try:
        sequence, _ = sequence_in(bag, path, sequence_name(bag.path), options)
    except StoneError as error:
        if error.code not in WITHOUT_A_RUN:
            return (Finding(error.code, "error", "", str(error)),), None
        unmeasured = f"neither the ground nor the cameras were checked: {error}"
        return (Finding(error.code, "warning", "", unmeasured),), None
    kept = [finding for finding in sequence.findings if finding.code.startswith(OF_CALIBRATIONS)]
    refusal = ground_refusal(sequence)
    if refusal is not None:
        kept.append(Finding(refusal.code, "error", "", str(refusal)))
    return tuple(finding for finding in kept if not _is_said_by_channels(finding)), sequence.ground


def _is_said_by_channels(finding: Finding) -> bool:
    """Return whether the finding lists cameras unknown to the calibration, as the channel findings already do."""
    return finding.code == MissingSensorError.code and not finding.topic
