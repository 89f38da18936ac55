"""Synchronisation in a sandboxed process: recordings and their calibration become a sequence.

**Conventions.** The child joins several recordings and describes the result in `joined.json`. It writes `sequence` and
`sweeps`, which may be large, into its folder, and returns the findings so far; findings of pictures and registered
sweeps follow from the late checks (below). The parent moves the files without opening them, except `joined.json`, which
it checks. The labeler's reader opens the other files and does not unpickle.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE, SWEEPS_FILE
from services.ingest.joining.clocks import JoinRequest, join_recordings
from services.ingest.pipeline import SynchroniseOptions, late_findings
from services.ingest.sequence import sequence_in
from services.runtime.in_place.errors import content_changed
from services.runtime.in_place.places import sha256_in_place
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.sandbox.result_files import File, SandboxResult, packed, unpacked
from stone.findings import Finding
from stone_files.bag_fingerprint import whole_sha256
from stone_files.joined_file import JOINED, JoinedFileError, read_joined
from stone_recordings.bags.bag import open_bag
from stone_recordings.bags.content_hash import content_sha256
from stone_recordings.joining.joined_recording import write_joined
from stone_recordings.report.overlay import overlays_of
from stone_recordings.sync.sequence_file import read_sequence, sequence_bytes
from stone_recordings.sync.stored_recording import StoredRecording
from stone_recordings.sync.sweeps import read_sweeps, sweeps_bytes
from stone_recordings.sync.validity import validity_findings

SYNCHRONISED = "synchronise"
JOINT = "joint"  # the folder of the joined recording
MOST_FINDINGS = 100


@dataclass(frozen=True)
class StoredBags:
    """The recordings of a run: on this machine and in the store, in one order.

    `sha256s` are the known hashes by name; `offsets_ns` are clock offsets given by the owner.
    """

    paths: tuple[Path, ...]
    kept: tuple[StoredRecording, ...]
    sha256s: Mapping[str, str]
    offsets_ns: Mapping[str, int]

    @property
    def files(self) -> StoredRecording:
        """All of their files, as one recording."""
        return StoredRecording(self.kept[0].name, tuple(file for recording in self.kept for file in recording.files))

    @property
    def is_in_place(self) -> bool:
        """Whether a recording is in place; chunks are then not read only for checking."""
        return any(recording.place for recording in self.kept)


@dataclass(frozen=True)
class SynchronisationRequest:
    """The bags, the calibration on this machine, and the facts in its row."""

    bags: StoredBags
    calibration: Path
    name: str
    valid_ns: tuple[int | None, int | None]
    options: SynchroniseOptions


@dataclass(frozen=True)
class SynchronisationResult:
    """`result` is the job's; `files` are to be moved to the paths of their names.

    `contents` are the content hashes of recordings in place, by name.
    """

    result: dict[str, Any]
    files: Mapping[str, Path]
    contents: Mapping[str, str]


def synchronised(request: SynchronisationRequest, apart: JobSandbox) -> SynchronisationResult:
    """Synchronise in a child.

    Raises what `join_recordings` and `open_sequence` raise, `SandboxCrashedError`, `ConfinedInterruptedError`,
    `JobCancelledError`.
    """
    answer = apart.run(partial(synchronise_bags, request), SYNCHRONISED, 2)
    made = _believed(unpacked(answer), apart.folder)
    _refuse_other_content(made.contents, request.bags)
    return with_description(made, apart.folder / JOINT, request.bags) if len(request.bags.paths) > 1 else made


def synchronise_bags(request: SynchronisationRequest, folder: Path, progress: ProgressCallback) -> bytes:
    """Synchronise within the child."""
    path, sha256 = _one_bag(request, folder)
    options = replace(request.options, progress=progress, recording_sha256=sha256, is_checked=False)
    with open_bag(path) as bag:
        if request.bags.is_in_place:
            bag.read_sparingly()
        sequence, sweeps = sequence_in(bag, request.calibration, request.name, options)
    (folder / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    (folder / SWEEPS_FILE).write_bytes(sweeps_bytes(sweeps, request.bags.files))
    result = {
        "frames": len(sequence.frames),
        "excluded": len(sequence.excluded),
        "pose_source": sequence.pose_source,
        "findings": short_records((*sequence.findings, *validity_findings(sequence, *request.valid_ns))),
        "is_checked": False,
    }
    return packed({"result": result, "contents": _contents_in_place(request.bags)})


def _contents_in_place(bags: StoredBags) -> dict[str, str]:
    contents = {}
    for path, kept in zip(bags.paths, bags.kept, strict=True):
        if kept.place is not None:
            with open_bag(path) as bag:
                contents[kept.name] = content_sha256(bag)
    return contents


def _refuse_other_content(contents: Mapping[str, str], bags: StoredBags) -> None:
    """Raise `recording_changed_in_place` if only the content of a recording's files changed."""
    for kept in bags.kept:
        if kept.place and sha256_in_place(kept.place, str(contents.get(kept.name))) != bags.sha256s[kept.name]:
            raise content_changed(kept.place)


def _one_bag(synchronisation: SynchronisationRequest, folder: Path) -> tuple[Path, str]:
    """Return the recording with its hash; several recordings are joined in a folder."""
    bags = synchronisation.bags
    if len(bags.paths) == 1:
        return bags.paths[0], bags.sha256s[bags.kept[0].name]
    joint = folder / JOINT
    request = JoinRequest(
        bags.paths, synchronisation.calibration, bags.offsets_ns, synchronisation.options, bags.is_in_place
    )
    joined = join_recordings(request)
    joint.mkdir()
    write_joined(joined, joint, bags.sha256s)
    parts = [(member.name, member.sha256) for member in read_joined(joint)]
    return joint, whole_sha256([*parts, (JOINED, sha256((joint / JOINED).read_bytes()).hexdigest())])


def with_description(made: SynchronisationResult, joint: Path, bags: StoredBags) -> SynchronisationResult:
    """Add `joined.json`, and each clock's offset to the result. Raises `SandboxCrashedError` if they are wrong."""
    path = joint / JOINED
    if not path.is_file() or path.is_symlink() or joint.is_symlink():
        raise SandboxCrashedError("wrote no description of the joined recordings")
    try:
        members = read_joined(joint)
    except JoinedFileError as error:
        raise SandboxCrashedError(f"wrote an invalid description of the joined recordings: {error}") from None
    if {member.name: member.sha256 for member in members} != dict(bags.sha256s):
        raise SandboxCrashedError("joined other recordings than the given ones")
    clocks = [
        {
            "recording": entry.name,
            "offset_ns": entry.offset_ns,
            "sigma_ns": entry.sigma_ns,
            "known_by": list(entry.known_by),
        }
        for entry in members
    ]
    return replace(made, result={**made.result, "clocks": clocks}, files={**made.files, JOINED: path})


def _believed(parcel: SandboxResult, folder: Path) -> SynchronisationResult:
    files = {name: folder / name for name in (SEQUENCE_FILE, SWEEPS_FILE)}
    match parcel.record:
        case {
            "result": {
                "frames": int(),
                "excluded": int(),
                "pose_source": str(),
                "findings": list(),
                "is_checked": False,
            } as result,
            "contents": dict(contents),
        } if all(path.is_file() and not path.is_symlink() for path in files.values()):
            return SynchronisationResult(result, files, contents)
    raise SandboxCrashedError("returned something other than a sequence")


def short_records(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Return the first findings, each short enough for a row."""
    short = (replace(finding, message=finding.message[:300], topic=finding.topic[:300]) for finding in findings)
    return [finding.as_record() for finding, _ in zip(short, range(MOST_FINDINGS), strict=False)]


# The late checks in a sandboxed process: findings of a synchronised sequence's pictures and registered sweeps. They do
# not change the sequence itself, so it is labelled meanwhile. The child reads the output of synchronisation and writes
# the sequence with all of its findings into its folder. It returns these findings and a picture per camera. The parent
# moves the file without opening it.


CHECKED = "check"


@dataclass(frozen=True)
class CheckRequest:
    """The folder with synchronisation's output, the local (possibly joined) bag, the calibration's validity."""

    left: Path
    bag: Path
    valid_ns: tuple[int | None, int | None]
    is_in_place: bool = False

    @property
    def files(self) -> tuple[Path, Path]:
        """The sequence and the description of its sweeps."""
        return self.left / SEQUENCE_FILE, self.left / SWEEPS_FILE


@dataclass(frozen=True)
class CheckResult:
    """`result` is the job's; `file` is to be moved to the path of its name."""

    result: dict[str, Any]
    file: Path
    overlays: tuple[File, ...]


def checked(request: CheckRequest, apart: JobSandbox) -> CheckResult:
    """Run the late checks in a child.

    Raises what `late_findings` and `overlays_of` raise, `SandboxCrashedError`, `ConfinedInterruptedError`,
    `JobCancelledError`.
    """
    return _believed_check(unpacked(apart.run(partial(check_left, request), CHECKED, 2)), apart.folder / CHECKED_FILE)


def check_left(request: CheckRequest, folder: Path, _progress: ProgressCallback) -> bytes:
    """Run the late checks within the child. Findings about the calibration's validity stay last."""
    sequence, sweeps = (path.read_bytes() for path in request.files)
    sequence_read, source = read_sequence(sequence), read_sweeps(sweeps, lambda _: request.bag)
    with open_bag(request.bag) as bag:
        if request.is_in_place:
            bag.read_sparingly()
        late = late_findings(bag, sequence_read, source)
        overlays = list(overlays_of(bag, sequence_read, source))
    findings = (*sequence_read.findings, *late, *validity_findings(sequence_read, *request.valid_ns))
    (folder / CHECKED_FILE).write_bytes(sequence_bytes(replace(sequence_read, findings=findings)))
    return packed({"findings": short_records(findings), "is_checked": True}, overlays)


def _believed_check(parcel: SandboxResult, path: Path) -> CheckResult:
    match parcel.record:
        case {"findings": list(), "is_checked": True} if path.is_file() and not path.is_symlink():
            return CheckResult(parcel.record, path, parcel.files)
    raise SandboxCrashedError("returned something other than findings")
