"""The work of the API's sandboxed children: they read a calibration or a class map of a stranger.

**Conventions.** The fork server loads this module first, so children import nothing: importing the API's own modules
took a child 1 to 4 s of its limits. So it imports readers alone, no route, view, domain or database.
"""

import json
from pathlib import Path

from services.runtime.sandbox.result_files import packed
from stone_datasets.classes import MEANINGS, read_class_map
from stone_recordings.calibrations.file import read_calibration_files
from stone_recordings.calibrations.record import calibration_record


def calibration_read(path: Path) -> bytes:
    """Return the calibration at a path as a record. Raises what reading raises."""
    calibration = read_calibration_files(path)
    findings = [finding.as_record() for finding in calibration.findings]
    read = {
        "calibration": calibration_record(calibration.calibration),
        "findings": findings,
        "format": calibration.format,
    }
    return packed(read)


def class_map_read(path: Path) -> bytes:
    """Return the name of a class map and the meanings of its numbers. Raises what reading raises."""
    class_map, words = read_class_map(path), {number: word for word, number in MEANINGS.items()}
    stated = {number: words[meaning] for number, meaning in enumerate(class_map.meaning.tolist()) if meaning in words}
    return json.dumps({"name": class_map.name, "meanings": stated}).encode()
