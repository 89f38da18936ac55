"""The export stage: a labelled sequence of the platform → files in one format → packs in the store.

**Conventions.** An attempt works in its own folder and deletes the folder of an earlier, killed attempt. Files move one
by one into packs, so the export is on the disk only once. Bytes are stored before any row. Rows and the job's success
are one transaction; an export deleted meanwhile gets no rows.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.inputs import phase_of_attempt, write_input
from services.domain.benchmarks.phases.unordered_frames import UnorderedFrames, unordered_frames
from services.domain.datasets.input_jobs import (
    InputResult,
    joined_key,
    sequence_key,
    version_of_attempt,
    write_version_input,
)
from services.domain.exports.requests import ExportResult, begin_export, write_export
from services.domain.sequences.label_sources import located_source
from services.domain.sequences.recordings import kept_recording, locate, locate_joined
from services.domain.sequences.run_files import SEQUENCE_FILE
from services.domain.sequences.stage_checks import require_sequence
from services.labeler.exports.dataset_source import DatasetSource, PlacedSource
from services.labeler.exports.registry import Exporter, exporter_of
from services.labeler.exports.sandboxed_export import (
    FILES,
    ExportInputs,
    LabelRange,
    PackedLabels,
    SourceAnswer,
    source_of,
    write_format,
    write_phase_input,
)
from services.labeler.exports.source import MESH, REPORT, TABLE
from services.labeler.kernel_warmup import warm
from services.runtime.in_place.datasets import opened_dataset
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Artefact, Blob, Export, LabelledFrameRow, Recording
from services.runtime.platform import Platform
from services.runtime.sandbox.job_sandbox import JobSandbox, SandboxedWork, private_folder_in
from services.runtime.store.blobs import PreparedBlob, prepare_all
from services.runtime.store.faults import refuse_damaged
from services.runtime.store.pack_reading import archive_sha256, local_reader
from services.runtime.store.packs import PackedFiles, index_bytes, pack_count, pack_folder, pack_path
from services.runtime.store.workspace import Workspace, fresh_folder
from stone.errors import Refused
from stone_files.bag_fingerprint import bag_paths
from stone_files.joined_file import JOINED, JoinedMember, read_joined
from stone_recordings.sync.stored_recording import StoredRecording

INDEX = "index.npz"
INPUTS = "inputs"


def export(platform: Platform, attempt: Attempt) -> Outcome:
    """Write the job's export.

    Raises `JobCancelledError` if the export or its sequence was deleted, and what the exporter raises.
    """
    with platform.database.transaction() as session:
        require_sequence(session, attempt)
        row = begin_export(session, attempt)
    with attempt_folder(platform, attempt) as folder:
        files = _write_packs(platform, attempt, row, folder)
        made = _store_export(platform, attempt, folder, files)
    attempt.log("exported", format=row.format, files=len(files), size_bytes=made.size_bytes)
    limit_bytes = platform.settings.uploads.owner_bytes
    result = {"export_id": row.id, "format": row.format, "files": len(files), "size_bytes": made.size_bytes}
    return Outcome(result, commit=lambda session: write_export(session, attempt, made, limit_bytes))


def located_inputs(platform: Platform, label_set_id: str, folder: Path, exporter: Exporter) -> ExportInputs:
    """Return the inputs of the label set's export on this machine, without sensor data.

    `folder` gets links with the files' own names. All files are compared with their published hashes; otherwise damaged
    data would be exported under a new hash. Raises `ObjectMissingError`, `ObjectDamagedError`.
    """
    with platform.database.reading() as session:
        named = select(Artefact.name, Blob.object_key).join(Blob, Blob.sha256 == Artefact.blob_sha256)
        keys = {name: key for name, key in session.execute(named.where(Artefact.label_set_id == label_set_id))}
        ranges = _ranges(session, label_set_id) if exporter.reads_labels else ()
    folder.mkdir(parents=True, exist_ok=True)
    linked = {name: keys[name] for name in (REPORT, SEQUENCE_FILE, MESH, TABLE, *({JOINED} & set(keys)))}
    read = {*linked.values(), *(at.pack for at in ranges)}
    refuse_damaged(platform.store, platform.database, read, "a label file")
    for name, key in linked.items():
        (folder / name).symlink_to(platform.store.local(key))
    packs = {key: platform.store.local(key) for key in sorted({at.pack for at in ranges})}
    return ExportInputs(folder, PackedLabels(packs, ranges))


@dataclass(frozen=True)
class ExportSandbox:
    """The working folder of an attempt's children, and their permitted inputs."""

    platform: Platform
    attempt: Attempt
    folder: Path

    def run(self, work: SandboxedWork, inputs: ExportInputs) -> bytes:
        """Run the work in a child. Raises as `JobSandbox.run`."""
        bag = inputs.recording
        files = (path.resolve() for path in inputs.folder.iterdir())
        measured = (*(bag_paths(bag) if bag else ()), *(inputs.source.paths if inputs.source else ()))
        reads = (inputs.folder, *files, *inputs.labels.packs.values(), *measured)
        with private_folder_in(self.folder) as temporary:
            sandbox = JobSandbox(self.folder, reads, self.attempt, self.platform.settings, warm, temporary)
            return sandbox.run(work, "export", 1)

    def fetched(self, read_bytes: int) -> None:
        """Log the number of bytes read from an object in place."""
        self.attempt.log("fetched", read_bytes=read_bytes)


@dataclass(frozen=True)
class ExportedLabels:
    """The exported label set and its sequence."""

    label_set_id: str
    sequence_id: str


@contextmanager
def with_samples(sandbox: ExportSandbox, inputs: ExportInputs, of: ExportedLabels) -> Iterator[ExportInputs]:
    """Yield the inputs with sensor data: the source of imported labels, or the labelled bag.

    Several bags are joined as described in `joined.json`. Raises `recording_deleted`, `JoinedFileError`, and for a
    source in place what `opened_dataset` raises.
    """
    platform = sandbox.platform
    with platform.database.reading() as session:
        located = located_source(session, of.label_set_id)
    if located is None:
        yield replace(inputs, recording=_recording(sandbox, inputs, of))
        return
    index, *packs = (platform.store.local(key) for key in (located.index_key, *located.pack_keys))
    source = DatasetSource(index, tuple(packs))
    if located.placed is None:
        yield replace(inputs, source=source)
        return
    placed_key, archive_place = located.placed
    with opened_dataset(platform.settings.in_place, archive_place, sandbox.folder, sandbox.fetched) as archive:
        placed = PlacedSource(platform.store.local(placed_key), archive)
        yield replace(inputs, source=replace(source, placed=placed))


def _recording(sandbox: ExportSandbox, inputs: ExportInputs, of: ExportedLabels) -> Path:
    """Return the path of the recording. Raises `recording_deleted`, `JoinedFileError`."""
    if (inputs.folder / JOINED).exists():
        return located_members(sandbox.platform, of.sequence_id, inputs.folder)
    made_of = SourceAnswer.believed(sandbox.run(partial(source_of, inputs), inputs))
    return located_recording(sandbox.platform, of.sequence_id, made_of.sha256s)


def _ranges(session: Session, label_set_id: str) -> tuple[LabelRange, ...]:
    """Return the label ranges of all frames, in order."""
    frames = (
        select(LabelledFrameRow, Blob.object_key)
        .join(Artefact, Artefact.id == LabelledFrameRow.pack_id)
        .join(Blob, Blob.sha256 == Artefact.blob_sha256)
        .where(LabelledFrameRow.label_set_id == label_set_id)
        .order_by(LabelledFrameRow.ordinal)
    )
    return tuple(
        LabelRange(frame.token, key, frame.offset_bytes, frame.length_bytes, frame.sha256)
        for frame, key in session.execute(frames)
    )


def attempt_folder(platform: Platform, attempt: Attempt) -> AbstractContextManager[Path]:
    """Return a fresh folder of this attempt, as `fresh_folder`."""
    work = Workspace(platform.store, platform.settings, attempt.root_id).folder
    return fresh_folder(work, f"export-{attempt.job_id}")


def pack_files(attempt: Attempt, folder: Path) -> PackedFiles:
    """Move the content of `files` in the attempt's folder into packs, and write their index."""
    files = pack_folder(folder / FILES, folder / "packs", partial(attempt.progress, "pack"))
    (folder / INDEX).write_bytes(index_bytes(files))
    return files


def stored_packs(platform: Platform, attempt: Attempt, folder: Path, files: PackedFiles) -> list[PreparedBlob]:
    """Store the index and the packs."""
    paths = [folder / INDEX, *(pack_path(folder / "packs", number) for number in range(pack_count(files)))]
    prepared = list[PreparedBlob]()
    attempt.progress("store", 0, len(paths))
    for blob in prepare_all(platform.store, platform.database, paths, adopt=True):
        prepared.append(blob)
        attempt.progress("store", len(prepared), len(paths))
    return prepared


def _write_packs(platform: Platform, attempt: Attempt, row: Export, folder: Path) -> PackedFiles:
    """Write the files in a child, then move them into packs."""
    exporter, sandbox = exporter_of(row.format), ExportSandbox(platform, attempt, folder)
    inputs = located_inputs(platform, row.label_set_id, folder / INPUTS, exporter)
    labels = ExportedLabels(row.label_set_id, row.sequence_id)
    (folder / FILES).mkdir()
    with with_samples(sandbox, inputs, labels) if exporter.reads_samples else nullcontext(inputs) as measured:
        sandbox.run(partial(write_format, row.format, measured), measured)
    return pack_files(attempt, folder)


def _store_export(platform: Platform, attempt: Attempt, folder: Path, files: PackedFiles) -> ExportResult:
    """Hash the future archives, and store packs and index."""
    read = local_reader(folder / "packs")
    tar = archive_sha256(files, "tar", read, partial(attempt.progress, "tar"))
    zipped = archive_sha256(files, "zip", read, partial(attempt.progress, "zip"))
    index, *packs = stored_packs(platform, attempt, folder, files)
    return ExportResult(files, index, packs, tar, zipped)


def recording_deleted(recording: str) -> Refused:
    return Refused("recording_deleted", f"recording {recording} was deleted, so its data cannot be exported any more")


def located_recording(platform: Platform, sequence_id: str, sha256s: Collection[str]) -> Path:
    """Return the sequence's bag with one of these hashes on this machine; it may have been deleted and uploaded again.

    Raises `recording_deleted`.
    """
    with platform.database.reading() as session:
        kept = _kept(session, sequence_id, sha256s)
    if kept is None:
        raise recording_deleted(", ".join(sorted(sha256s)))
    return locate(platform, kept)


def located_members(platform: Platform, sequence_id: str, described: Path) -> Path:
    """Return the joined recordings that `joined.json` in the folder `described` lists.

    Raises `recording_deleted`, `JoinedFileError` (BAG-040).
    """
    members = read_joined(described)
    with platform.database.reading() as session:
        recordings = {member.name: _kept(session, sequence_id, (member.sha256,)) for member in members}
    kept = {name: recording for name, recording in recordings.items() if recording is not None}
    if len(kept) < len(recordings):
        raise recording_deleted(_names(member for member in members if member.name not in kept))
    return locate_joined(platform, kept, described)


def _kept(session: Session, sequence_id: str, sha256s: Collection[str]) -> StoredRecording | None:
    registered = (Recording.sequence_id == sequence_id, Recording.state == "registered")
    same = select(Recording).where(*registered, Recording.sha256.in_(sha256s)).order_by(Recording.id).limit(1)
    recording = session.scalar(same)
    return None if recording is None else kept_recording(session, recording)


def _names(members: Iterable[JoinedMember]) -> str:
    return ", ".join(member.name for member in members)


# The stage that makes an input of a phase or dataset version: a synchronised sequence and its sensor data → files →
# packs in the store. Unlike an export, it does not even locate labels, mesh and report, so they cannot reach
# participants. Log lines and results contain only names, file counts and bytes.


def make_input(platform: Platform, attempt: Attempt) -> Outcome:
    """Write the job's input.

    Raises `JobCancelledError` if its phase or version was deleted, `inputs_impossible`, `recording_deleted`, and what
    the exporter raises.
    """
    is_of_version = "dataset_id" in attempt.arguments
    with platform.database.transaction() as session:
        if is_of_version:
            version_of_attempt(session, attempt)
            unordered = None
        else:
            phase = phase_of_attempt(session, attempt)
            unordered = unordered_frames(phase.every_nth, phase.token_key)
        keys = {SEQUENCE_FILE: sequence_key(session, attempt), JOINED: joined_key(session, attempt)}
    with attempt_folder(platform, attempt) as folder:
        made = _made_input(platform, attempt, (keys, unordered), folder)
    attempt.log("made", name=made.name, files=len(made.files), tar_bytes=made.tar[0])
    result = {"name": made.name, "files": len(made.files), "tar_bytes": made.tar[0]}
    write = write_version_input if is_of_version else write_input
    return Outcome(result, commit=lambda session: write(session, attempt, made))


def _made_input(
    platform: Platform, attempt: Attempt, of: tuple[Mapping[str, str | None], UnorderedFrames | None], folder: Path
) -> InputResult:
    """Store the input files of the sequence and return them.

    `of` has the store keys of the sources by name, and the selected frames.
    """
    keys, unordered = of
    name = str(attempt.arguments["name"])
    (folder / INPUTS).mkdir()
    for called, key in keys.items():
        if key is not None:
            (folder / INPUTS / called).symlink_to(platform.store.local(key))
    sandbox, inputs = ExportSandbox(platform, attempt, folder), ExportInputs(folder / INPUTS, PackedLabels({}, ()))
    labels = ExportedLabels(str(attempt.arguments["label_set_id"]), str(attempt.arguments["sequence_id"]))
    (folder / FILES).mkdir()
    with with_samples(sandbox, inputs, labels) as measured:
        sandbox.run(partial(write_phase_input, measured, unordered), measured)
    files = pack_files(attempt, folder)
    tar = archive_sha256(files, "tar", local_reader(folder / "packs"), partial(attempt.progress, "tar"))
    index, *packs = stored_packs(platform, attempt, folder, files)
    return InputResult(name, files, index, packs, tar)
