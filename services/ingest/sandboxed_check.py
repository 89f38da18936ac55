"""The late checks in a sandboxed process: what pictures and registered sweeps tell of a synchronised sequence.

**Conventions.** They change nothing but what is said of the sequence, so it is labelled meanwhile. The child reads what
synchronisation left, writes the sequence with all of its findings into its folder, and answers with these findings and
a picture per camera; the parent moves the file and never opens it.
"""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE, SWEEPS_FILE
from services.ingest.pipeline import late_findings
from services.ingest.sandboxed_synchronisation import short_records
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.sandbox.result_files import File, SandboxResult, packed, unpacked
from stone_recordings.bags.bag import open_bag
from stone_recordings.report.overlay import overlays_of
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from stone_recordings.sync.sweep_file import read_sweeps
from stone_recordings.sync.validity import validity_findings

CHECKED = "check"


@dataclass(frozen=True)
class CheckRequest:
    """What is checked: the folder that holds what synchronisation left, the bag on this machine (of several recordings
    the joined one), and when the calibration is valid."""

    left: Path
    bag: Path
    valid_ns: tuple[int | None, int | None]

    @property
    def files(self) -> tuple[Path, Path]:
        """The sequence and the description of its sweeps."""
        return self.left / SEQUENCE_FILE, self.left / SWEEPS_FILE


@dataclass(frozen=True)
class CheckResult:
    """`result` is the job's; `file` is to be moved to where its name says."""

    result: dict[str, Any]
    file: Path
    overlays: tuple[File, ...]


def checked(asked: CheckRequest, apart: JobSandbox) -> CheckResult:
    """Raises what `late_findings` and `overlays_of` raise, `SandboxCrashedError`, `ConfinedInterruptedError`,
    `JobCancelledError`."""
    return _believed(unpacked(apart.run(partial(check_left, asked), CHECKED, 2)), apart.folder / CHECKED_FILE)


def check_left(asked: CheckRequest, folder: Path, _progress: ProgressCallback) -> bytes:
    """The child's part. What is said of the calibration's time stays last."""
    sequence, sweeps = (path.read_bytes() for path in asked.files)
    found, source = read_sequence(sequence), read_sweeps(sweeps, lambda _: asked.bag)
    with open_bag(asked.bag) as bag:
        late = late_findings(bag, found, source)
        overlays = list(overlays_of(bag, found, source))
    findings = (*found.findings, *late, *validity_findings(found, *asked.valid_ns))
    (folder / CHECKED_FILE).write_bytes(sequence_bytes(replace(found, findings=findings)))
    return packed({"findings": short_records(findings), "is_checked": True}, overlays)


def _believed(parcel: SandboxResult, path: Path) -> CheckResult:
    match parcel.record:
        case {"findings": list(), "is_checked": True} if path.is_file() and not path.is_symlink():
            return CheckResult(parcel.record, path, parcel.files)
    raise SandboxCrashedError("answered something else than what it found")
