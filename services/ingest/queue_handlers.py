"""The stages of ingest in the queue.

`register` reads a recording, `synchronise` makes a sequence from it, `check` examines its pictures and registered
sweeps, and `keep_dataset` stores the archive of a published dataset.

**Conventions.** A stage is a function of the platform and an attempt. It may run twice, concurrently or after being
killed anywhere, and writes the same bytes. Files for the labeler are in the workspace of the run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from sqlalchemy.orm import Session

from services.domain.imports.requests import INDEX, KEEP_DATASET, import_of_attempt, kept_import, place_of
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.domain.sequences.previews import PreparedPreview, PreviewSubject, prepared_previews, replace_previews
from services.domain.sequences.processing import CHECK, LABEL, REGISTER, SYNCHRONISE
from services.domain.sequences.recordings import kept_recording, locate, locate_file, locate_run, unchanged
from services.domain.sequences.restart import arguments_of_run
from services.domain.sequences.run_files import CHECKED_FILE, SEQUENCE_FILE, SWEEPS_FILE, require_left
from services.domain.sequences.stage_checks import require_sequence
from services.domain.sequences.unusable_labels import record_unusable
from services.ingest.errors import RecordingChangedError, recording_file_missing
from services.ingest.kernel_warmup import warm
from services.ingest.pipeline import SynchroniseOptions
from services.ingest.registration import register
from services.ingest.sandboxed_synchronisation import (
    CHECKED,
    SYNCHRONISED,
    CheckRequest,
    StoredBags,
    SynchronisationRequest,
    checked,
    synchronised,
)
from services.runtime.in_place.datasets import found_dataset, refuse_changed_dataset
from services.runtime.in_place.places import sha256_in_place
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Handlers, JobSpec, Outcome
from services.runtime.orm import Blob, CalibrationRow, DatasetImport, Recording, Upload
from services.runtime.platform import Platform
from services.runtime.sandbox.job_sandbox import JobSandbox, private_folder_in
from services.runtime.store.blobs import PreparedBlob, link, link_all, prepare
from services.runtime.store.workspace import Workspace
from services.runtime.uploads.backends import backend_of, remove_bytes
from stone_files.atomic import flush
from stone_files.bag_fingerprint import bag_paths
from stone_files.joined_file import JOINED
from stone_recordings.sync.stored_recording import RecordingPlace, StoredRecording, StoredRecordingFile


@dataclass(frozen=True)
class _Inputs:
    """Facts of rows about a sequence's inputs; `sha256s` of its recordings by name."""

    name: str
    recordings: tuple[StoredRecording, ...]
    sha256s: Mapping[str, str]
    calibration: StoredRecordingFile
    valid_ns: tuple[int | None, int | None]


def handlers(platform: Platform) -> Handlers:
    """Return the stages by kind."""
    stages = {
        REGISTER: register,
        SYNCHRONISE: synchronise_recording,
        CHECK: check_sequence,
        KEEP_DATASET: keep_dataset,
    }
    return {kind: partial(stage, platform) for kind, stage in stages.items()}


def synchronise_recording(platform: Platform, attempt: Attempt) -> Outcome:
    """Write the sequence, the description of its sweeps, and `joined.json` of several recordings to the workspace.

    Raises what `synchronised` and `arguments_of_run` raise.
    """
    arguments_of_run(platform, attempt)
    inputs = _inputs(platform, attempt, attempt.arguments)
    attempt.progress(SYNCHRONISED, 0, 2)
    options = SynchroniseOptions(
        odometry_topic=attempt.arguments["odometry_topic"] or None,
        lidar_topic=attempt.arguments["lidar_topic"] or None,
        topics=attempt.arguments.get("topics", {}),
        ground=attempt.arguments.get("ground", "given"),
    )
    paths, calibration = _locate_bags(platform, inputs.recordings), locate_file(platform, inputs.calibration)
    offsets_ns = attempt.arguments.get("clock_offsets_ns", {})
    bags = StoredBags(paths, inputs.recordings, inputs.sha256s, offsets_ns)
    request = SynchronisationRequest(bags, calibration, inputs.name, inputs.valid_ns, options)
    workspace = Workspace(platform.store, platform.settings, attempt.root_id)
    with private_folder_in(workspace.folder) as folder, unchanged(platform, inputs.recordings):
        reads = (*(bag_path for path in paths for bag_path in bag_paths(path)), calibration)
        made = synchronised(request, JobSandbox(folder, reads, attempt, platform.settings, warm, makes_links=True))
        attempt.progress(SYNCHRONISED, 1, 2)
        for name, made_file in made.files.items():
            flush(made_file)
            made_file.replace(workspace.folder / name)
    workspace.push(*made.files)
    attempt.progress(SYNCHRONISED, 2, 2)
    attempt.log("synchronised", frames=made.result["frames"], excluded=made.result["excluded"])
    then = (CHECK, LABEL) if "label" in attempt.arguments["stages"] else (CHECK,)
    return Outcome(made.result, then=tuple(JobSpec(kind) for kind in then))


def check_sequence(platform: Platform, attempt: Attempt) -> Outcome:
    """Write the sequence with all of its findings to the workspace; only the publication of labels needs it.

    Raises what `checked` and `arguments_of_run` raise, `work_gone`.
    """
    arguments = arguments_of_run(platform, attempt)
    inputs = _inputs(platform, attempt, arguments)
    attempt.progress(CHECKED, 0, 2)
    workspace = Workspace(platform.store, platform.settings, attempt.root_id)
    workspace.pull(SEQUENCE_FILE, SWEEPS_FILE, JOINED)
    require_left(workspace.folder, (SEQUENCE_FILE, SWEEPS_FILE))
    bag, is_in_place = (
        locate_run(platform, inputs.recordings, workspace.folder),
        any(recording.place for recording in inputs.recordings),
    )
    request = CheckRequest(workspace.folder, bag, inputs.valid_ns, is_in_place)
    with private_folder_in(workspace.folder) as folder, unchanged(platform, inputs.recordings):
        reads = (*bag_paths(request.bag), *request.files)
        made = checked(request, JobSandbox(folder, reads, attempt, platform.settings, warm))
        attempt.progress(CHECKED, 1, 2)
        overlays = prepared_previews(platform, workspace.folder, made.overlays)
        flush(made.file)
        made.file.replace(workspace.folder / CHECKED_FILE)
    workspace.push(CHECKED_FILE)
    attempt.progress(CHECKED, 2, 2)
    attempt.log("checked", findings=len(made.result["findings"]))
    shown = PreviewSubject(attempt.sequence_id or "", recipe=arguments["recipe"])
    return Outcome(made.result, commit=lambda session: _show(session, shown, overlays, made.result))


def _locate_bags(platform: Platform, recordings: Sequence[StoredRecording]) -> tuple[Path, ...]:
    """Return the bags on this machine."""
    return tuple(locate(platform, recording) for recording in recordings)


def _show(
    session: Session, shown: PreviewSubject, overlays: tuple[PreparedPreview, ...], result: Mapping[str, Any]
) -> None:
    link_all(session, (overlay.blob for overlay in overlays))
    replace_previews(session, shown, overlays)
    record_unusable(session, shown.sequence_id, result["findings"])


def _inputs(platform: Platform, attempt: Attempt, arguments: Mapping[str, Any]) -> _Inputs:
    with platform.database.reading() as session:
        sequence = require_sequence(session, attempt)
        recordings = [session.get(Recording, recording_id) for recording_id in recording_ids_of(arguments)]
        existing = [recording for recording in recordings if recording is not None]
        if len(existing) < len(recordings):
            raise JobCancelledError("its recording was deleted")
        kept = tuple(kept_recording(session, recording) for recording in existing)
        sha256s = {recording.filename: recording.sha256 for recording in existing}
        calibration = session.get_one(CalibrationRow, arguments["calibration_id"])
        rig = session.get_one(Blob, calibration.blob_sha256)
        valid_ns = (calibration.valid_from_ns, calibration.valid_to_ns)
    return _Inputs(sequence.name, kept, sha256s, StoredRecordingFile(rig.object_key, calibration.filename), valid_ns)


# The stage that stores the uploaded archive of a dataset as a blob, for the labeler's workers. For an archive in place
# it records size and version, which every later stage compares. The upload's file stays until the blob's row is
# written, so an attempt killed anywhere is repeated; the sweeper deletes a remaining file. The archive is not opened
# here: its bytes are hashed and stored.


def keep_dataset(platform: Platform, attempt: Attempt) -> Outcome:
    """Store the archive.

    Raises `JobCancelledError`, `recording_file_missing`, `RecordingChangedError`, what the store raises; for an archive
    in place what `refuse_changed_dataset` raises.
    """
    imported = import_of_attempt(platform, attempt)
    if archive_place := place_of(imported):
        size_bytes = _note_archive(platform, attempt, archive_place)
        return Outcome({"size_bytes": size_bytes}, then=(JobSpec(INDEX),))
    if imported.blob_sha256 is None:
        attempt.progress("keep", 0, 1)
        _keep(platform, attempt, imported)
        attempt.log("kept", filename=imported.name, size_bytes=imported.size_bytes)
    return Outcome({"size_bytes": imported.size_bytes}, then=(JobSpec(INDEX),))


def _note_archive(platform: Platform, attempt: Attempt, archive_place: RecordingPlace) -> int:
    """Return the size of the archive at the place, comparing it with the recorded size or recording it."""
    settings = platform.settings.in_place
    if archive_place.files:
        refuse_changed_dataset(settings, archive_place)
        return archive_place.size_bytes
    noted = found_dataset(settings, archive_place)
    with platform.database.transaction() as session:
        row = kept_import(session, attempt)
        row.place, row.size_bytes = noted.as_record(), noted.size_bytes
        row.sha256 = sha256_in_place(noted, str(noted))
    attempt.log("noted", place=str(noted), size_bytes=noted.size_bytes)
    return noted.size_bytes


def _keep(platform: Platform, attempt: Attempt, imported: DatasetImport) -> None:
    with platform.database.reading() as session:
        upload = session.get_one(Upload, imported.upload_id)
    try:
        with backend_of(platform, upload).local(upload) as path:
            prepared = prepare(platform.store, platform.database, path, adopt=True)
            _write(platform, attempt, imported, prepared)
    except FileNotFoundError as error:
        raise recording_file_missing(upload.filename, upload.id) from error
    remove_bytes(platform, [upload.id])


def _write(platform: Platform, attempt: Attempt, imported: DatasetImport, prepared: PreparedBlob) -> None:
    """Write the rows. Raises `RecordingChangedError`, `JobCancelledError`."""
    if prepared.sha256 != imported.sha256:
        raise RecordingChangedError(imported.name, prepared.sha256, imported.sha256)
    with platform.database.transaction() as session:
        kept_import(session, attempt).blob_sha256 = link(session, prepared).sha256
