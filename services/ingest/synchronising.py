"""A recording and its calibration become a sequence in the child that reads them; its parent takes what it left.

**Conventions.** The child writes `sequence` and `sweeps` into its folder, which may be large, and answers with the
pictures and what is said of the run. The parent moves the files and never opens them: the labeler's reader does, which
unpickles nothing.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from services.ingest.apart import Apart
from services.ingest.bag import open_bag
from services.ingest.opening import open_sequence
from services.ingest.overlay import overlays_of
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sweep_file import Kept, sweeps_bytes
from services.ingest.validity import validity_findings
from services.runtime.confined import ConfinedCrashedError, Progress
from services.runtime.confined.parcel import File, Parcel, packed, unpacked
from services.runtime.run_files import SEQUENCE_FILE, SWEEPS_FILE
from services.runtime.sequence_file import sequence_bytes
from stone.findings import Finding

SYNCHRONISED = "synchronise"
MOST_FINDINGS = 100


@dataclass(frozen=True)
class Asked:
    """What is to be made of what: the bag and the calibration on this machine, and what rows say of them."""

    path: Path
    calibration: Path
    name: str
    kept: Kept
    valid_ns: tuple[int | None, int | None]
    options: SynchroniseOptions


@dataclass(frozen=True)
class Synchronised:
    """`result` is the job's; `files` are to be moved to where their names say."""

    result: dict[str, Any]
    files: Mapping[str, Path]
    overlays: tuple[File, ...]


def synchronised(asked: Asked, apart: Apart) -> Synchronised:
    """Raises what `open_sequence` raises, `ConfinedCrashedError`, `ConfinedInterruptedError`, `JobCancelledError`."""
    answer = apart.read(partial(_synchronise, asked), SYNCHRONISED, 2)
    return _believed(unpacked(answer), apart.folder)


def _synchronise(asked: Asked, folder: Path, progress: Progress) -> bytes:
    """The child's part."""
    options = replace(asked.options, progress=progress)
    sequence, sweeps = open_sequence(asked.path, asked.calibration, asked.name, options)
    sequence = replace(sequence, findings=(*sequence.findings, *validity_findings(sequence, *asked.valid_ns)))
    (folder / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    (folder / SWEEPS_FILE).write_bytes(sweeps_bytes(sweeps, asked.kept))
    result = {
        "frames": len(sequence.frames),
        "excluded": len(sequence.excluded),
        "pose_source": sequence.pose_source,
        "findings": _findings(sequence.findings),
    }
    with open_bag(asked.path) as bag:
        return packed(result, overlays_of(bag, sequence, sweeps))


def _believed(parcel: Parcel, folder: Path) -> Synchronised:
    files = {name: folder / name for name in (SEQUENCE_FILE, SWEEPS_FILE)}
    match parcel.record:
        case {"frames": int(), "excluded": int(), "pose_source": str(), "findings": list()} if all(
            path.is_file() and not path.is_symlink() for path in files.values()
        ):
            return Synchronised(parcel.record, files, parcel.files)
    raise ConfinedCrashedError("answered something else than a sequence")


def _findings(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """The first of them, each short enough for a row."""
    short = (replace(finding, message=finding.message[:300], topic=finding.topic[:300]) for finding in findings)
    return [finding.as_record() for finding, _ in zip(short, range(MOST_FINDINGS), strict=False)]
