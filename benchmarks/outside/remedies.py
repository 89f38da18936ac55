"""Rows of drives whose fault is corrected by the product's remedy: ground auto, or the values of its findings.

**Conventions.** A row with a remedy is named "fault, remedy".
"""

import json
import re
from pathlib import Path

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import open_sequence
from stone.sensors.sequence import Sequence, SweepSource
from testing.outside.faults import FAULTS

GROUND_AUTO, AS_ADVISED = "ground auto", "as advised"
TILTED = ("mount pitch 2°", "mount pitch -2°", "mount roll 2°", "mount roll -2°")
ROWS = (
    *FAULTS,
    *(f"{fault}, {GROUND_AUTO}" for fault in TILTED),
    *(f"{fault}, {AS_ADVISED}" for fault in (TILTED[0], "INS tilted 2°")),
)
ENTRY = re.compile(r"(ego_from_lidar|lidar_from_sensor of (\w+)) at \[([^]]*)\] m, wxyz \[([^]]*)\]")


def fault_of(row: str) -> str:
    """Return the fault of a row's name."""
    return row.partition(", ")[0]


def opened(row: str, bag: Path, calibration: Path) -> tuple[Sequence, SweepSource]:
    """Return the recording opened with the row's remedy."""
    _, _, remedy = row.partition(", ")
    if remedy == AS_ADVISED:
        enter_advice(calibration, open_sequence(bag, calibration, "outside")[0])
    options = SynchroniseOptions(ground="auto" if remedy == GROUND_AUTO else "given")
    return open_sequence(bag, calibration, "outside", options)


def enter_advice(calibration: Path, sequence: Sequence) -> None:
    """Write the values of a sequence's findings CAL-433 and SYN-518 into a calibration file."""
    rig = json.loads(calibration.read_text())
    sentences = " ".join(finding.message for finding in sequence.findings if finding.code in ("CAL-433", "SYN-518"))
    for _, sensor, position, turn in ENTRY.findall(sentences):
        entry = rig["sensors"][sensor]["lidar_from_sensor"] if sensor else rig["ego_from_lidar"]
        entry["translation_m"] = [float(number) for number in position.split(",")]
        entry["rotation_wxyz"] = [float(number) for number in turn.split(",")]
    calibration.write_text(json.dumps(rig))
