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
    """A recording assumed to be sound is damaged outside its sweeps; `with_sequence` opens it again."""


def open_sequence(
    bag: Path, calibration: Path, name: str, options: SynchroniseOptions | None = None
) -> tuple[Sequence, BagSweeps]:
    """Return the sequence `name`, with the findings about the calibration and the hashes of both files.

    Raises what `read_calibration` and `synchronise` raise.
    """
    with open_bag(bag) as opened:
        return sequence_in(opened, calibration, name, options or SynchroniseOptions())


def sequence_in(bag: Bag, calibration: Path, name: str, options: SynchroniseOptions) -> tuple[Sequence, BagSweeps]:
    """As `open_sequence`, for an open recording, which may also be the calibration."""
    rig, noticed = read_calibration(calibration, bag)
    sequence, sweeps = synchronise_in(bag, rig, options, name)
    inputs = {**sequence.inputs, calibration.name: calibration_sha256(calibration)}
    return replace(sequence, inputs=inputs, findings=(*noticed, *sequence.findings)), sweeps


@dataclass(frozen=True, eq=False)
class OpenedSequence:
    """A sequence whose recording is still being hashed and checked.

    `recording_inputs` waits for the inputs missing in its `inputs`, `late_findings` for those to append to its
    `findings`.
    """

    sequence: Sequence
    sweeps: BagSweeps
    recording_inputs: Callable[[], Mapping[str, str]]
    late_findings: Callable[[], tuple[Finding, ...]]


def with_sequence(
    bag: Path, calibration: Path, name: str, options: SynchroniseOptions, use: Callable[[OpenedSequence], T]
) -> T:
    """Return the result of `use` on the opened sequence; `use` reads every sweep and requests the late findings.

    The recording is first assumed to be sound, so that its chunks are checked as its sweeps are read, and inflated
    once. If that fails because of damage, `use` is called again with a sequence that excludes damaged data. Raises what
    opening and `use` raise.
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
    """As `open_sequence`, but the recording is hashed and checked while the block runs.

    A long recording is thus read from disk once: later reads find it in memory. If `is_believed`, it is not checked for
    damage beforehand; then reading a sweep refuses it, or `late_findings` does (FoundDamagedError).
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
    """Return the late findings, and release inflated chunks. Raises `FoundDamagedError`."""
    findings = late_findings(bag, sequence, sweeps)
    if bag.is_believed and bag.damaged_beside({sweeps.topic: sweeps.message_index}):
        raise FoundDamagedError
    bag.release()
    return findings


def _is_damaged(path: Path) -> bool:
    with open_bag(path) as bag:
        return bool(bag.damaged)
