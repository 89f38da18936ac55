"""Opens a recording with its calibration as a synchronised sequence, on one machine."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from services.ingest.pipeline import SynchroniseOptions, synchronise_in
from stone.sensors.sequence import Sequence
from stone_files.bag_fingerprint import hashed_meanwhile
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.calibrations.file import calibration_sha256, read_calibration
from stone_recordings.sync.sweeps import BagSweeps


def open_sequence(
    bag: Path, calibration: Path, name: str, options: SynchroniseOptions | None = None
) -> tuple[Sequence, BagSweeps]:
    """The sequence `name`; it carries what was noticed about the calibration, and the hashes of both files.

    Raises what `read_calibration` and `synchronise` raise.
    """
    with open_bag(bag) as opened:
        return sequence_in(opened, calibration, name, options or SynchroniseOptions())


def sequence_in(bag: Bag, calibration: Path, name: str, options: SynchroniseOptions) -> tuple[Sequence, BagSweeps]:
    """As `open_sequence`, of the recording that the caller has open; it may be the calibration too."""
    rig, noticed = read_calibration(calibration, bag)
    sequence, sweeps = synchronise_in(bag, rig, options, name)
    inputs = {**sequence.inputs, calibration.name: calibration_sha256(calibration)}
    return replace(sequence, inputs=inputs, findings=(*noticed, *sequence.findings)), sweeps


@dataclass(frozen=True, eq=False)
class OpenedSequence:
    """A sequence whose recording is still being hashed: `recording_inputs` waits for what its `inputs` lack."""

    sequence: Sequence
    sweeps: BagSweeps
    recording_inputs: Callable[[], Mapping[str, str]]


@contextmanager
def opened_sequence(bag: Path, calibration: Path, name: str, options: SynchroniseOptions) -> Iterator[OpenedSequence]:
    """As `open_sequence`, but what is done inside goes on while the recording is hashed.

    A long recording is then read once by the disk: what comes after the hash finds it in memory.
    """
    with hashed_meanwhile(bag, options.recording_sha256) as inputs:
        sequence, sweeps = open_sequence(bag, calibration, name, replace(options, is_hashed=False))
        yield OpenedSequence(sequence, sweeps, inputs)
