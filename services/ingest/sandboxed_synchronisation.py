"""Synchronisation in a sandboxed process: a recording and its calibration become a sequence.

**Conventions.** The child writes `sequence` and `sweeps` into its folder, which may be large, and answers with the
pictures and what is said of the run. The parent moves the files and never opens them: the labeler's reader does, which
unpickles nothing.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from services.domain.sequences.run_files import SEQUENCE_FILE, SWEEPS_FILE
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import sequence_in
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.sandbox.result_files import File, SandboxResult, packed, unpacked
from stone.findings import Finding
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.overlay import overlays_of
from stone_recordings.sync.sequence_file import sequence_bytes
from stone_recordings.sync.stored_recording import StoredRecording
from stone_recordings.sync.sweep_file import sweeps_bytes
from stone_recordings.sync.validity import validity_findings

SYNCHRONISED = "synchronise"
MOST_FINDINGS = 100


@dataclass(frozen=True)
class SynchronisationRequest:
    """What is to be made of what: the bag and the calibration on this machine, and what rows say of them."""

    path: Path
    calibration: Path
    name: str
    kept: StoredRecording
    valid_ns: tuple[int | None, int | None]
    options: SynchroniseOptions


@dataclass(frozen=True)
class SynchronisationResult:
    """`result` is the job's; `files` are to be moved to where their names say."""

    result: dict[str, Any]
    files: Mapping[str, Path]
    overlays: tuple[File, ...]


def synchronised(asked: SynchronisationRequest, apart: JobSandbox) -> SynchronisationResult:
    """Raises what `open_sequence` raises, `SandboxCrashedError`, `ConfinedInterruptedError`, `JobCancelledError`."""
    answer = apart.run(partial(_synchronise, asked), SYNCHRONISED, 2)
    return _believed(unpacked(answer), apart.folder)


def _synchronise(asked: SynchronisationRequest, folder: Path, progress: ProgressCallback) -> bytes:
    """The child's part."""
    options = replace(asked.options, progress=progress)
    with open_bag(asked.path) as bag:
        sequence, sweeps = sequence_in(bag, asked.calibration, asked.name, options)
        overlays = list(overlays_of(bag, sequence, sweeps))
    sequence = replace(sequence, findings=(*sequence.findings, *validity_findings(sequence, *asked.valid_ns)))
    (folder / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    (folder / SWEEPS_FILE).write_bytes(sweeps_bytes(sweeps, asked.kept))
    result = {
        "frames": len(sequence.frames),
        "excluded": len(sequence.excluded),
        "pose_source": sequence.pose_source,
        "findings": _findings(sequence.findings),
    }
    return packed(result, overlays)


def _believed(parcel: SandboxResult, folder: Path) -> SynchronisationResult:
    files = {name: folder / name for name in (SEQUENCE_FILE, SWEEPS_FILE)}
    match parcel.record:
        case {"frames": int(), "excluded": int(), "pose_source": str(), "findings": list()} if all(
            path.is_file() and not path.is_symlink() for path in files.values()
        ):
            return SynchronisationResult(parcel.record, files, parcel.files)
    raise SandboxCrashedError("answered something else than a sequence")


def _findings(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """The first of them, each short enough for a row."""
    short = (replace(finding, message=finding.message[:300], topic=finding.topic[:300]) for finding in findings)
    return [finding.as_record() for finding, _ in zip(short, range(MOST_FINDINGS), strict=False)]
