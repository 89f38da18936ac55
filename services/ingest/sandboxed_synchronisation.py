"""Synchronisation in a sandboxed process: recordings and their calibration become a sequence.

**Conventions.** The child joins recordings where they are several, and writes `joined.json`, which says how. It writes
`sequence` and `sweeps` into its folder, which may be large, and answers with what is said of the run so far: what only
pictures and registered sweeps tell is left to the late checks (below). The parent moves
the files and never opens them, but for `joined.json`, which it checks: the labeler's reader does, which unpickles
nothing.
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

    `sha256s` are known of each by its name; `offsets_ns` are of clocks that its owner knows.
    """

    paths: tuple[Path, ...]
    kept: tuple[StoredRecording, ...]
    sha256s: Mapping[str, str]
    offsets_ns: Mapping[str, int]

    @property
    def files(self) -> StoredRecording:
        """All of their files, as one recording."""
        return StoredRecording(self.kept[0].name, tuple(file for one in self.kept for file in one.files))

    @property
    def is_in_place(self) -> bool:
        """Whether one of them stays where it lies: chunks are then not read only to be checked."""
        return any(one.place for one in self.kept)


@dataclass(frozen=True)
class SynchronisationRequest:
    """What is to be made of what: the bags, the calibration on this machine, and what its row says of it."""

    bags: StoredBags
    calibration: Path
    name: str
    valid_ns: tuple[int | None, int | None]
    options: SynchroniseOptions


@dataclass(frozen=True)
class SynchronisationResult:
    """`result` is the job's; `files` are to be moved to where their names say. `contents` are the hashes of what was
    read of recordings in place, by name."""

    result: dict[str, Any]
    files: Mapping[str, Path]
    contents: Mapping[str, str]


def synchronised(asked: SynchronisationRequest, apart: JobSandbox) -> SynchronisationResult:
    """Raises what `join_recordings` and `open_sequence` raise, `SandboxCrashedError`, `ConfinedInterruptedError`,
    `JobCancelledError`."""
    answer = apart.run(partial(synchronise_bags, asked), SYNCHRONISED, 2)
    made = _believed(unpacked(answer), apart.folder)
    _refuse_other_content(made.contents, asked.bags)
    return with_description(made, apart.folder / JOINT, asked.bags) if len(asked.bags.paths) > 1 else made


def synchronise_bags(asked: SynchronisationRequest, folder: Path, progress: ProgressCallback) -> bytes:
    """The child's part."""
    path, sha256 = _one_bag(asked, folder)
    options = replace(asked.options, progress=progress, recording_sha256=sha256, is_checked=False)
    with open_bag(path) as bag:
        if asked.bags.is_in_place:
            bag.read_sparingly()
        sequence, sweeps = sequence_in(bag, asked.calibration, asked.name, options)
    (folder / SEQUENCE_FILE).write_bytes(sequence_bytes(sequence))
    (folder / SWEEPS_FILE).write_bytes(sweeps_bytes(sweeps, asked.bags.files))
    result = {
        "frames": len(sequence.frames),
        "excluded": len(sequence.excluded),
        "pose_source": sequence.pose_source,
        "findings": short_records((*sequence.findings, *validity_findings(sequence, *asked.valid_ns))),
        "is_checked": False,
    }
    return packed({"result": result, "contents": _contents_in_place(asked.bags)})


def _contents_in_place(bags: StoredBags) -> dict[str, str]:
    contents = {}
    for path, kept in zip(bags.paths, bags.kept, strict=True):
        if kept.place is not None:
            with open_bag(path) as bag:
                contents[kept.name] = content_sha256(bag)
    return contents


def _refuse_other_content(contents: Mapping[str, str], bags: StoredBags) -> None:
    """Raises `recording_changed_in_place` for a recording whose files look as they did and hold something else."""
    for kept in bags.kept:
        if kept.place and sha256_in_place(kept.place, str(contents.get(kept.name))) != bags.sha256s[kept.name]:
            raise content_changed(kept.place)


def _one_bag(asked: SynchronisationRequest, folder: Path) -> tuple[Path, str]:
    """The recording with its hash; of several, the folder in which they are joined."""
    bags = asked.bags
    if len(bags.paths) == 1:
        return bags.paths[0], bags.sha256s[bags.kept[0].name]
    joint = folder / JOINT
    request = JoinRequest(bags.paths, asked.calibration, bags.offsets_ns, asked.options, bags.is_in_place)
    joined = join_recordings(request)
    joint.mkdir()
    write_joined(joined, joint, bags.sha256s)
    parts = [(member.name, member.sha256) for member in read_joined(joint)]
    return joint, whole_sha256([*parts, (JOINED, sha256((joint / JOINED).read_bytes()).hexdigest())])


def with_description(made: SynchronisationResult, joint: Path, bags: StoredBags) -> SynchronisationResult:
    """With `joined.json`, and in the result the offset of each clock. Raises `SandboxCrashedError` where it lies."""
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
        {"recording": one.name, "offset_ns": one.offset_ns, "sigma_ns": one.sigma_ns, "known_by": list(one.known_by)}
        for one in members
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
    """The first of them, each short enough for a row."""
    short = (replace(finding, message=finding.message[:300], topic=finding.topic[:300]) for finding in findings)
    return [finding.as_record() for finding, _ in zip(short, range(MOST_FINDINGS), strict=False)]


# The late checks in a sandboxed process: what pictures and registered sweeps tell of a synchronised sequence.
#
# **Conventions.** They change nothing but what is said of the sequence, so it is labelled meanwhile. The child reads
# what synchronisation left, writes the sequence with all of its findings into its folder, and answers with these
# findings and a picture per camera; the parent moves the file and never opens it.


CHECKED = "check"


@dataclass(frozen=True)
class CheckRequest:
    """What is checked: the folder that holds what synchronisation left, the bag on this machine (of several recordings
    the joined one), and when the calibration is valid."""

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
    """`result` is the job's; `file` is to be moved to where its name says."""

    result: dict[str, Any]
    file: Path
    overlays: tuple[File, ...]


def checked(asked: CheckRequest, apart: JobSandbox) -> CheckResult:
    """Raises what `late_findings` and `overlays_of` raise, `SandboxCrashedError`, `ConfinedInterruptedError`,
    `JobCancelledError`."""
    return _believed_check(unpacked(apart.run(partial(check_left, asked), CHECKED, 2)), apart.folder / CHECKED_FILE)


def check_left(asked: CheckRequest, folder: Path, _progress: ProgressCallback) -> bytes:
    """The child's part. What is said of the calibration's time stays last."""
    sequence, sweeps = (path.read_bytes() for path in asked.files)
    found, source = read_sequence(sequence), read_sweeps(sweeps, lambda _: asked.bag)
    with open_bag(asked.bag) as bag:
        if asked.is_in_place:
            bag.read_sparingly()
        late = late_findings(bag, found, source)
        overlays = list(overlays_of(bag, found, source))
    findings = (*found.findings, *late, *validity_findings(found, *asked.valid_ns))
    (folder / CHECKED_FILE).write_bytes(sequence_bytes(replace(found, findings=findings)))
    return packed({"findings": short_records(findings), "is_checked": True}, overlays)


def _believed_check(parcel: SandboxResult, path: Path) -> CheckResult:
    match parcel.record:
        case {"findings": list(), "is_checked": True} if path.is_file() and not path.is_symlink():
            return CheckResult(parcel.record, path, parcel.files)
    raise SandboxCrashedError("returned something other than findings")
