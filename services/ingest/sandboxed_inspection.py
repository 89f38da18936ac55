"""The inspection of a recording in a sandboxed process, and the checks of that process's answer.

    files → (truncated files are recovered) → inspection → quality → previews → a parcel

**Conventions.** The child writes recovered files into its folder and returns everything else. The parent treats records
as untrusted JSON of bounded size, and accepts a recovered file only at the path that it requested.
"""

import json
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from services.domain.sequences.profiles import topics_of
from services.ingest.errors import recording_file_missing
from services.ingest.pipeline import SynchroniseOptions, synchronise_in, unjoined_sequence
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.orm import Blob, Recording, RecordingFile, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.sandbox import ProgressCallback, SandboxCrashedError
from services.runtime.sandbox.job_sandbox import JobSandbox
from services.runtime.sandbox.result_files import File, SandboxResult, packed, unpacked
from services.runtime.store.keys import ObjectMissingError
from services.runtime.store.named_objects import NAMES_FOLDER, named, named_folder
from services.runtime.uploads.backends import backend_of
from stone.errors import PlatformFaultError, Refused, StoneError
from stone.findings import Finding, Severity
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration, Mount
from stone.sensors.ground_plane import GroundFit
from stone.sensors.ground_refusals import ground_refusal
from stone_files.bag_fingerprint import bag_paths
from stone_recordings.bags.bag import Bag, open_bag
from stone_recordings.bags.content_hash import content_sha256
from stone_recordings.bags.errors import CutBagError, IngestError
from stone_recordings.bags.recovery.recovery import recover
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.poses.ego_track import recorded_rig
from stone_recordings.report.inspection import Inspection, inspect_in, inspection_record, scanned
from stone_recordings.report.previews.pictures import previews_of
from stone_recordings.report.quality.page import quality_page
from stone_recordings.report.quality.report import quality_of
from stone_recordings.report.quality.sampling import SampledMessages
from stone_recordings.report.scan import Scan
from stone_recordings.sync.clock_offsets import ClockOffsets
from stone_recordings.sync.ground_check import early_refusal, measured_ground, recorded_ground_finding
from stone_recordings.sync.reference_check import reference_refusal
from stone_recordings.sync.sweeps import SweepsOfOpenBag
from stone_recordings.topics.profiles import TopicProfile

# The outlook of a recording: faults for which labelling would refuse or exclude data. The same synchronisation as in
# labelling finds them, and they are added to the findings of the inspection. With a calibration, everything before
# labelling is checked, and what labelling would refuse is an error. Without one, a rig with all sensors at one place
# stands in for it, and findings about mounts are omitted. A refusal is then an error too, except on the platform, where
# a later calibration with a clock offset, or a file of poses, may avert it.


NAME = "outlook"
STAND_IN = Calibration(name="none", ego_from_lidar=SE3.identity(), mounts=(Mount("INS", "ins", SE3.identity()),))
OF_MOUNTS = "CAL-"
OF_POSES = frozenset({"SYN-530", "SYN-533", "SYN-534", "SYN-535"})


def inspected_in(
    bag: Bag,
    profile: TopicProfile | None = None,
    calibration: Path | None = None,
    options: SynchroniseOptions | None = None,
    *,
    scan: Scan | None = None,
    is_complete: bool = True,
) -> Inspection:
    """Return the inspection with the outlook's findings; the topics of `options` are those of the profile.

    `scan` avoids a second scan if the caller has one; the recording is read once for both. If `is_complete` is False,
    more data may follow, and a refusal without a calibration is only a warning. Raises as `inspect_in` and
    `read_calibration`.
    """
    requested = replace(options or SynchroniseOptions(), topics=profile.topics if profile else {}, is_hashed=False)
    scan = scan or scanned(bag, requested.asked_topics)
    inspection = inspect_in(bag, profile, scan)
    if requested.poses is not None:
        kept = tuple(finding for finding in inspection.findings if finding.code != "TOP-103")
        inspection = replace(inspection, findings=kept)
    options = replace(requested, recorded=scan.recorded)
    if calibration is None:
        added, ground = stood_in(bag, options, "error" if is_complete else "warning")
        inspection = replace(inspection, lidar_ground=ground)
        if ground is not None and scan.recorded is not None and scan.recorded.sources is not None:
            mounts = recorded_rig(scan.recorded, scan.recorded.sources, STAND_IN, ClockOffsets())
            added += recorded_ground_finding(ground, mounts.tree, mounts.lidar_frame)
    else:
        rig, noticed = read_calibration(calibration, bag)
        added = (*noticed, *outlook(bag, rig, options))
    return replace(inspection, findings=with_new(inspection.findings, added))


def outlook(bag: Bag, calibration: Calibration, options: SynchroniseOptions) -> tuple[Finding, ...]:
    """Return the findings of synchronisation; a refusal, also of labelling's ground check, is an error."""
    try:
        sequence, sweeps = synchronise_in(bag, calibration, replace(options, is_hashed=False), NAME)
    except StoneError as error:
        return (_refused(error, "error"),)
    refusal = ground_refusal(sequence)
    if refusal is None and options.ground == "given":
        with suppress(StoneError):
            refusal = early_refusal(bag, sweeps.topic, calibration)
    refusal = refusal or reference_refusal(sequence, SweepsOfOpenBag(sweeps, bag))
    return (*sequence.findings, *(() if refusal is None else (_refused(refusal, "error"),)))


def stood_in(
    bag: Bag, options: SynchroniseOptions, severity: Severity = "error"
) -> tuple[tuple[Finding, ...], GroundFit | None]:
    """Return the outlook without a calibration, and the ground in the LiDAR's frame, to judge a calibration early.

    A refusal has the given severity; a refusal of the poses themselves is always an error.
    """
    try:
        sequence, sweeps = unjoined_sequence(bag, STAND_IN, options, NAME)
        ground = measured_ground(sequence, SweepsOfOpenBag(sweeps, bag), None)
    except StoneError as refusal:
        return (_refused(refusal, "error" if refusal.code in OF_POSES else severity),), None
    return tuple(finding for finding in sequence.findings if not finding.code.startswith(OF_MOUNTS)), ground


def _refused(refusal: StoneError, severity: Severity) -> Finding:
    return Finding(refusal.code, severity, "", str(refusal))


def with_new(known: tuple[Finding, ...], added: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Return both without repetitions: equal code, severity and topic (or none), or equal reason and topic."""
    codes, named = {finding.code for finding in known}, {(finding.code, finding.topic) for finding in known}
    refused = {finding.code for finding in known if finding.severity == "error"}
    reasons = [(finding.topic, finding.message) for finding in known if finding.topic]

    def is_new(finding: Finding) -> bool:
        if finding.severity == "error":
            return finding.code not in refused
        is_named = (finding.code, finding.topic) in named or (not finding.topic and finding.code in codes)
        return not is_named and not any(finding.topic == at and why in finding.message for at, why in reasons)

    return (*known, *filter(is_new, added))


# The files of an uploaded recording on this machine, opened as one bag.


@dataclass(frozen=True)
class ReceivedFile:
    """A file's row and its current local `path`."""

    row_id: str
    upload_id: str
    filename: str
    sha256: str
    path: Path


@dataclass(frozen=True)
class ReceivedBag:
    """A received recording; `folder` contains the named files on this machine.

    `profile` is its owner's topic choice for the robot. For a recording in place, `here` is the bag, and there are no
    files.
    """

    recording_id: str
    sequence_id: str
    name: str
    files: tuple[ReceivedFile, ...]
    folder: Path
    profile: TopicProfile
    here: Path | None = None

    @property
    def reads(self) -> tuple[Path, ...]:
        """The files that contain its bytes."""
        return tuple(file.path for file in self.files) if self.here is None else bag_paths(self.here)

    def bag(self, instead: Mapping[str, Path] | None = None) -> Path:
        """Return the bag under its owner's name: a file, or a folder with the files.

        `instead` maps a `row_id` to the file that replaces it.
        """
        if self.here is not None:
            return self.here
        read = [((instead or {}).get(file.row_id, file.path), file.filename) for file in self.files]
        return named(self.folder, *read[0]) if len(read) == 1 else named_folder(self.folder, read, self.name)


@dataclass(frozen=True)
class _StoredFile:
    """The stored location of a file's bytes: a blob, or an upload."""

    row: RecordingFile
    blob: Blob | None
    upload: Upload | None


@contextmanager
def received(platform: Platform, recording_id: str, here: Path | None = None) -> Iterator[ReceivedBag]:
    """Yield the recording with its files on this machine, or `here`; temporary copies are deleted afterwards.

    Raises `JobCancelledError` (deleted), `recording_refused`, `recording_file_missing`, what the store raises.
    """
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        if recording is None:
            raise JobCancelledError("its recording was deleted")
        kept = [_kept(session, row) for row in recording.files]
        sequence = session.get_one(SequenceRow, recording.sequence_id)
        profile = TopicProfile(topics_of(session, sequence), sequence.platform)
    folder = platform.settings.root / NAMES_FOLDER
    with ExitStack() as copies:
        files = tuple(_file(recording, file.row, _path(platform, file, copies)) for file in kept)
        yield ReceivedBag(recording_id, sequence.id, recording.filename, files, folder, profile, here)


def _kept(session: Session, row: RecordingFile) -> _StoredFile:
    blob = session.get(Blob, row.blob_sha256) if row.blob_sha256 else None
    return _StoredFile(row, blob, session.get(Upload, row.upload_id) if row.upload_id else None)


def _path(platform: Platform, kept: _StoredFile, copies: ExitStack) -> Path | None:
    """Return the path of the bytes, or None if they do not exist."""
    with suppress(FileNotFoundError, ObjectMissingError):
        if kept.blob is not None:
            return platform.store.local(kept.blob.object_key)
        if kept.upload is not None:
            return copies.enter_context(backend_of(platform, kept.upload).local(kept.upload))
    return None


def _file(recording: Recording, row: RecordingFile, path: Path | None) -> ReceivedFile:
    if path is not None:
        return ReceivedFile(row.id, row.upload_id or "", row.filename, row.sha256, path)
    if recording.state == "refused":  # by an attempt killed before it could report the refusal
        raise Refused("recording_refused", f"{recording.filename} was refused: {recording.findings[0]['message']}")
    raise recording_file_missing(row.filename, row.upload_id or "")


# Recovery of truncated recording files: the readable part is written to a new file, the original is unchanged.
# Recovering the same file always gives the same bytes (`stone_recordings/bags/recovery/recovery.py`), so a repeated
# attempt gives the same file.


@dataclass(frozen=True)
class RecoveredFile:
    """An MCAP file that replaces a truncated file, and the findings about it."""

    path: Path
    finding: Finding


def recovered_files(received: ReceivedBag, folder: Path) -> dict[str, RecoveredFile]:
    """Return the recovered files by the `row_id` of the truncated files; they are written into `folder`.

    Raises the refusal of a file from which nothing could be read.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cut = [file for file in received.files if _is_cut(received, file)]
    return {file.row_id: _recover_file(received.folder, file, folder) for file in cut}


def _is_cut(received: ReceivedBag, file: ReceivedFile) -> bool:
    try:
        open_bag(named(received.folder, file.path, file.filename)).close()
    except CutBagError:
        return True
    except PlatformFaultError:
        raise
    except IngestError:  # not a bag on its own: a metadata.yaml, a database without its log
        return False
    return False


def _recover_file(names: Path, file: ReceivedFile, folder: Path) -> RecoveredFile:
    path, out = named(names, file.path, file.filename), folder / f"{file.row_id}.mcap"
    recovery = recover(path, out)
    if recovery.messages == 0:
        raise CutBagError(file.filename, recovery.read_bytes)
    return RecoveredFile(out, recovery.finding)


QUALITY_RECORD, QUALITY_PAGE = "quality.json", "quality.html"
RECOVERED, NAMES = "recovered", "names"
STEPS = 4


@dataclass(frozen=True)
class RecordingSurvey:
    """The records of inspection and quality as stored in rows; `drawn` are the previews.

    `recovered` are the replacements of truncated files, by their row. `content_sha256` is empty unless the recording is
    in place.
    """

    inspection: dict[str, Any]
    quality: dict[str, Any]
    topics: int
    findings: int
    recovered: Mapping[str, Path]
    drawn: tuple[File, ...]
    content_sha256: str = ""


def seen(brought: ReceivedBag, apart: JobSandbox) -> RecordingSurvey:
    """Survey the recording in a child.

    Raises the `BAG-*` refusals, `SandboxCrashedError`, `ConfinedInterruptedError`, `JobCancelledError`.
    """
    answer = apart.run(partial(_look, brought), "inspect", STEPS)
    return _validate_survey(unpacked(answer), brought, apart.folder)


def _look(brought: ReceivedBag, folder: Path, progress: ProgressCallback) -> bytes:
    """Survey the recording within the child."""
    ours = replace(brought, folder=folder / NAMES)
    with ExitStack() as files:
        bag, inspection, recovered = _inspected_in(files, ours, folder / RECOVERED)
        recoveries = tuple(file.finding for file in recovered.values())
        inspection = replace(inspection, findings=(*recoveries, *inspection.findings))
        progress("measure", 1, STEPS)
        facts = {"recovered": list(recovered), "content_sha256": content_sha256(bag) if ours.here else ""}
        return _measured(ours.name, inspection, SampledMessages(bag, is_sparing=ours.here is not None), facts)


def _inspected_in(
    files: ExitStack, ours: ReceivedBag, folder: Path
) -> tuple[Bag, Inspection, dict[str, RecoveredFile]]:
    """Return the bag, open as long as `files`, its inspection, and the recovered files."""
    try:
        bag = files.enter_context(open_bag(ours.bag()))
        if ours.here is not None:
            bag.read_sparingly()
        return bag, inspected_in(bag, ours.profile, is_complete=False), {}
    except CutBagError:
        recovered = recovered_files(ours, folder)
        if not recovered:
            raise
    files.close()
    bag = files.enter_context(open_bag(ours.bag({row_id: file.path for row_id, file in recovered.items()})))
    return bag, inspected_in(bag, ours.profile, is_complete=False), recovered


def _measured(name: str, inspection: Inspection, sampled: SampledMessages, facts: Mapping[str, Any]) -> bytes:
    bag = sampled.bag
    quality = quality_of(bag, inspection, sampled)
    pictures = tuple(previews_of(bag, inspection, sampled))
    page = quality_page(name, inspection, quality, pictures)
    record = json.dumps(quality.as_record(), indent=1, allow_nan=False).encode()
    content = {
        "inspection": inspection_record(inspection),
        "quality": quality.as_record(),
        "topics": len(inspection.topics),
        "findings": len(inspection.findings),
        **facts,
    }
    own = ((QUALITY_RECORD, "application/json", record), (QUALITY_PAGE, "text/html", page))
    return packed(content, (*own, *pictures))


def _validate_survey(parcel: SandboxResult, brought: ReceivedBag, folder: Path) -> RecordingSurvey:
    match parcel.record:
        case {
            "inspection": {"findings": list(), **_inspected} as inspection,
            "quality": {"score": int(), **_measured} as quality,
            "topics": int(topics),
            "findings": int(findings),
            "recovered": list(row_ids),
            "content_sha256": str(content),
        } if set(map(str, row_ids)) <= {file.row_id for file in brought.files}:
            recovered = {row_id: _plain(folder, f"{RECOVERED}/{row_id}.mcap") for row_id in row_ids}
            return RecordingSurvey(inspection, quality, topics, findings, recovered, parcel.files, content)
    raise SandboxCrashedError("returned something other than a survey")


def _plain(folder: Path, name: str) -> Path:
    """Return a regular file directly in the folder, not reached through a link."""
    path = folder / name
    if path.resolve() != folder.resolve() / name or not path.is_file():
        raise SandboxCrashedError("recovered no file at the reported path")
    return path
