"""The row of one run of `benchmarks.faults`, made in a process of its own."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from testing.worlds.faults.catalogue import FAULTS
from testing.worlds.faults.drive import SoundDrive
from testing.worlds.faults.outcome import LabelledDrive, codes, inspected, outcome


def outcome_of(drive: SoundDrive, name: str, clean: Mapping[int, NDArray[np.uint8]]) -> dict[str, Any]:
    """Return the outcome of a fault in a process of its own; an error without a code becomes a row."""
    fault = next(fault for fault in FAULTS if fault.name == name)
    with tempfile.TemporaryDirectory(prefix="stone-fault-") as folder:
        try:
            return outcome(drive, fault, Path(folder), clean).as_record()
        except Exception as error:
            return {"named": (), "errors": (), "refusal": f"CRASH {type(error).__name__}", "sentence": str(error)[:300]}


def row_of_sound(drive: SoundDrive, clean: LabelledDrive) -> dict[str, Any]:
    shares = clean.report.class_shares()
    return {
        "named": codes(inspected(drive.bag, drive.rig())),
        "errors": (),
        "refusal": "",
        "frames": len(clean.report.sequence.frames),
        "excluded": {},
        "found": codes(clean.report.findings),
        "beyond": 0,
        "p_share": shares["potentially_traversable"],
        "agreement": 1.0,
    }
