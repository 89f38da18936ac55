"""A short drive of the simulated full rig and its labels, made once and exported by many tests."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from services.ingest.sequence import open_sequence
from services.labeler.exports.source import LabelledSequence, folder_source
from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import parameters_for
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_recordings.sync.samples import checked_samples

OPTIONS = SimulateOptions(0.8, 3, channels=16, columns=240, camera_width_px=96, world_width_m=60.0, speed_m_s=2.5)


@dataclass(frozen=True)
class Labelled:
    """`folder` is what `stone label` leaves of the recording `bag`."""

    bag: Path
    folder: Path

    @property
    def report(self) -> dict[str, Any]:
        report: dict[str, Any] = json.loads((self.folder / "report.json").read_text())
        return report

    def source(self) -> LabelledSequence:
        return folder_source(self.folder, checked_samples)


def made_labels(root: Path) -> None:
    """Eight sweeps, six cameras and three radars."""
    bag, calibration = root / "drive.mcap", root / "drive.calibration.yaml"
    simulate(bag, OPTIONS)
    sequence, sweeps = open_sequence(bag, calibration, "drive")
    source = {"recording": str(bag), "calibration": str(calibration)}
    label(sequence, sweeps, root / "labels", LabelOptions(parameters_for("local"), 1, source))


def labelled_in(root: Path) -> Labelled:
    return Labelled(root / "drive.mcap", root / "labels")


def files_of(folder: Path) -> dict[str, bytes]:
    """Every file below a folder by its name there."""
    paths = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def unheard(_done: int, _total: int) -> None:
    """Nobody asks how far an export is."""
