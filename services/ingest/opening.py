"""From the two files a field engineer has, a recording and a calibration, to the sequence that is labelled."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from services.ingest.calibration_file import calibration_sha256, read_calibration
from services.ingest.fingerprint import hashed_meanwhile
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


@dataclass(frozen=True, eq=False)
class Opened:
    """A sequence whose recording is still being hashed: `recording_inputs` waits for what its `inputs` lack."""

    sequence: Sequence
    sweeps: BagSweeps
    recording_inputs: Callable[[], Mapping[str, str]]


@contextmanager
def opened_sequence(bag: Path, calibration: Path, name: str, options: SynchroniseOptions) -> Iterator[Opened]:
    """As `open_sequence`, but what is done inside goes on while the recording is hashed.

    A long recording is then read once by the disk: what comes after the hash finds it in memory.
    """
    with hashed_meanwhile(bag, options.recording_sha256) as sha256:
        sequence, sweeps = open_sequence(bag, calibration, name, replace(options, is_hashed=False))
        yield Opened(sequence, sweeps, lambda: {bag.name: sha256()})
