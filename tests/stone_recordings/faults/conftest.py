"""One short drive, recorded once without a fault and once with each: what the platform says of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import pytest

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from simulator.options import FaultName, SimulateOptions
from simulator.pipeline import calibration_path, simulate
from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.sequence import Sequence
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.report.inspection import Inspection, inspect

# A host whose stamps are the receiver's: the default one is late by up to 20 ms, which is a finding of its own.
CLEAN = SimulateOptions(
    seconds=6.0,
    seed=5,
    channels=16,
    columns=180,
    camera_width_px=64,
    compression="none",
    world_width_m=30.0,
    host_delay_max_ns=0,
    transport_jitter_ns=300_000,
)
# Pictures are most of the work, so only the clean drive and these have any.
OF_CAMERAS: set[FaultName] = {"camera_late_5ms", "camera_dropped", "cameras_swapped", "extrinsic_inverted"}


@dataclass(frozen=True, eq=False)
class Told:
    """What inspection, calibration and synchronisation said of one drive; `sequence` is None where it was refused."""

    inspection: Inspection
    sequence: Sequence | None
    findings: tuple[Finding, ...]

    @property
    def codes(self) -> set[tuple[str, str]]:
        """Code and topic (or channel) of each finding."""
        return {(finding.code, finding.topic) for finding in self.findings}

    def sentence(self, code: str, topic: str) -> str:
        return next(found.message for found in self.findings if (found.code, found.topic) == (code, topic))


Telling = Callable[..., Told]


@pytest.fixture(scope="package")
def told(tmp_path_factory: pytest.TempPathFactory) -> Telling:
    """`told("rtk_gap", ...)`: the drive with these faults, looked at once a session."""

    @cache
    def tell(*faults: FaultName) -> Told:
        bag = tmp_path_factory.mktemp("drive") / "run.mcap"
        simulate(bag, replace(CLEAN, faults=faults, cameras=not faults or bool(OF_CAMERAS & set(faults))))
        return _told(bag)

    return tell


def _told(bag: Path) -> Told:
    inspection = inspect(bag)
    _calibration, doubts = read_calibration(calibration_path(bag))
    findings = inspection.findings + tuple(doubts)
    try:
        sequence, _sweeps = open_sequence(bag, calibration_path(bag), "run", SynchroniseOptions())
    except StoneError as refusal:
        return Told(inspection, None, (*findings, Finding(refusal.code, "error", "", str(refusal))))
    return Told(inspection, sequence, findings + sequence.findings)
