"""From the two files a field engineer has, a recording and a calibration, to the sequence that is labelled."""

from dataclasses import replace
from pathlib import Path

from services.ingest.calibration_file import calibration_sha256, read_calibration
from services.ingest.pipeline import SynchroniseOptions, synchronise
from services.ingest.sweeps import BagSweeps
from stone.sequence import Sequence


def open_sequence(
    bag: Path, calibration: Path, name: str, options: SynchroniseOptions | None = None
) -> tuple[Sequence, BagSweeps]:
    """The sequence `name`; it carries what was noticed about the calibration, and the hashes of both files.

    Raises what `read_calibration` and `synchronise` raise.
    """
    rig, noticed = read_calibration(calibration)
    sequence, sweeps = synchronise(bag, rig, options or SynchroniseOptions(), name)
    inputs = {**sequence.inputs, calibration.name: calibration_sha256(calibration)}
    return replace(sequence, inputs=inputs, findings=(*noticed, *sequence.findings)), sweeps
