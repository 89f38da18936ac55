"""Opens a recording with its calibration as a synchronised sequence, on one machine."""

from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from services.ingest.pipeline import SynchroniseOptions, late_findings, synchronise_in
from stone.errors import StoneError
from stone.findings import Finding
from stone.sensors.sequence import Sequence
from stone_files.bag_fingerprint import hashed_meanwhile
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.calibrations.file import calibration_sha256, read_calibration
from stone_recordings.sync.sweeps import BagSweeps

T = TypeVar("T")


class FoundDamagedError(Exception):
    """A recording that was believed is damaged where no sweep lies; `with_sequence` opens it again."""


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
    """A sequence whose recording is still being hashed and checked: `recording_inputs` waits for what its `inputs`
    lack, `late_findings` for what is to follow its `findings`."""

    sequence: Sequence
    sweeps: BagSweeps
    recording_inputs: Callable[[], Mapping[str, str]]
    late_findings: Callable[[], tuple[Finding, ...]]


def with_sequence(
    bag: Path, calibration: Path, name: str, options: SynchroniseOptions, use: Callable[[OpenedSequence], T]
) -> T:
    """What `use` makes of the opened sequence; it reads every sweep and asks for the late findings.

    The recording is believed at first, so that its chunks are checked as its sweeps are read, and inflated once. Where
    that fails and the recording is damaged, `use` is called again, with a sequence that leaves out what is damaged.
    Raises what opening and `use` raise.
    """
    try:
        with opened_sequence(bag, calibration, name, options, is_believed=True) as opened:
            return use(opened)
    except (StoneError, FoundDamagedError):
        if not _is_damaged(bag):
            raise
    with opened_sequence(bag, calibration, name, options) as opened:
        return use(opened)


@contextmanager
def opened_sequence(
    bag: Path, calibration: Path, name: str, options: SynchroniseOptions, *, is_believed: bool = False
) -> Iterator[OpenedSequence]:
    """As `open_sequence`, but what is done inside goes on while the recording is hashed and checked.

    A long recording is then read once by the disk: what comes after the hash finds it in memory. One that `is_believed`
    is not looked at for damage before; then reading a sweep refuses it, or `late_findings` does (FoundDamagedError).
    """
    late = replace(options, is_hashed=False, is_checked=False)
    with (
        hashed_meanwhile(bag, options.recording_sha256) as inputs,
        open_bag(bag) as opened,
        ThreadPoolExecutor(1) as beside,
    ):
        if is_believed:
            opened.believe()
        sequence, sweeps = sequence_in(opened, calibration, name, late)
        checked = beside.submit(_checked, opened, sequence, sweeps)
        yield OpenedSequence(sequence, sweeps, inputs, checked.result)


def _checked(bag: Bag, sequence: Sequence, sweeps: BagSweeps) -> tuple[Finding, ...]:
    """The late findings; what was inflated for them is given back. Raises `FoundDamagedError`."""
    found = late_findings(bag, sequence, sweeps)
    if bag.is_believed and bag.damaged_beside({sweeps.topic: sweeps.message_index}):
        raise FoundDamagedError
    bag.release()
    return found


def _is_damaged(path: Path) -> bool:
    with open_bag(path) as bag:
        return bool(bag.damaged)
