"""Recordings: created once from complete uploads, deleted with their bytes.

**Conventions.** Each function is part of the caller's transaction and locks the sequence's row first
(`services/domain/sequences/processing.py`). The bytes of a recording count against its owner under the ids of its
uploads.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.domain.exports.requests import EXPORT
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.domain.sequences.processing import PROCESS, REGISTER, lock_sequence, register
from services.runtime.access import storage_quota
from services.runtime.in_place.folders import located_in_place
from services.runtime.in_place.places import checked_after, is_by_ranges, refuse_changed, requested_place
from services.runtime.in_place.settings import InPlaceSettings
from services.runtime.jobs.control import cancel
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Blob, Job, Recording, RecordingFile, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.blobs import PreparedBlob
from services.runtime.store.faults import comparing
from services.runtime.store.named_objects import NAMES_FOLDER, described_folder, named, named_folder
from services.runtime.telemetry.tracing import link_uploads_of
from services.runtime.uploads import consume
from stone.errors import Refused
from stone_files.bag_fingerprint import bad_bag_files, check_bag_files, whole_sha256
from stone_files.joined_file import JOINED, JoinedFileError, read_joined
from stone_recordings.sync.stored_recording import RecordingPlace, StoredRecording, StoredRecordingFile

PURPOSE = "recording"


def recording_in_use(recording_id: str, job_id: str) -> Refused:
    return Refused(
        "recording_in_use", f"job {job_id} is reading recording {recording_id}; wait for the job, or cancel it first"
    )


@dataclass(frozen=True)
class NewRecording:
    """Complete uploads for one recording: a single file, or the files of a bag called `name`."""

    upload_ids: tuple[str, ...]
    name: str = ""


def add_recording(
    session: Session, sequence: SequenceRow, received: NewRecording, uploader_id: str
) -> tuple[Recording, Job]:
    """Consume complete uploads of the uploader, all or none; return the recording and the job that reads and stores it.

    Raises `SequenceDeletedError`, what `uploads.consume` raises, `wrong_upload_target`, `bad_recording_files`,
    `QueueDrainingError`.
    """
    sequence = lock_sequence(session, sequence.id)
    if len(set(received.upload_ids)) < len(received.upload_ids):
        raise bad_bag_files("an upload is listed twice")
    ordered = sorted(received.upload_ids)  # a common lock order prevents deadlocks
    uploads = [_consume_uploads(session, upload_id, uploader_id, sequence.id) for upload_id in ordered]
    uploads.sort(key=lambda upload: upload.filename)
    recording = _recording_of(sequence, uploads, received.name)
    session.add(recording)
    session.flush()
    link_uploads_of(session, recording.id)
    return recording, register(session, recording)


def add_in_place(
    session: Session, settings: InPlaceSettings, sequence: SequenceRow, requested: RecordingPlace
) -> tuple[Recording, Job]:
    """Return a recording that is read in place, and the job that reads it.

    The job checks whether the recording exists, on a machine that has the root. Raises `unknown_root`, `bad_place`,
    `not_by_ranges`, `SequenceDeletedError`, `QueueDrainingError`.
    """
    resolved = requested_place(settings, requested)
    sequence = lock_sequence(session, sequence.id)
    named = sha256(str(resolved).encode()).hexdigest()
    recording = Recording(sequence_id=sequence.id, filename=resolved.name, size_bytes=0, sha256=named, files=[])
    recording.place = resolved.as_record()
    session.add(recording)
    session.flush()
    return recording, register(session, recording)


def keep_excerpt(session: Session, settings: Settings, recording: Recording, excerpt: Sequence[PreparedBlob]) -> None:
    """Store the excerpt of a recording in place, linked by the caller; its bytes count against the owner.

    Raises `quota_exceeded`.
    """
    if recording.files or not excerpt:
        return
    recording.files = [
        RecordingFile(
            ordinal=ordinal,
            filename=kept.path.name,
            size_bytes=kept.size_bytes,
            sha256=kept.sha256,
            blob_sha256=kept.sha256,
        )
        for ordinal, kept in enumerate(excerpt)
    ]
    owner_id = session.get_one(SequenceRow, recording.sequence_id).owner_id
    size_bytes, limit_bytes = sum(kept.size_bytes for kept in excerpt), settings.uploads.owner_bytes
    storage_quota.reserve(session, owner_id, size_bytes, recording.id, "recording in place", limit_bytes)


def remove_recording(session: Session, recording: Recording) -> None:
    """Remove the recording from its sequence and release its bytes; results made from it stay.

    Raises `SequenceDeletedError`, `recording_in_use`.
    """
    lock_sequence(session, recording.sequence_id)
    for run in _alive(session, recording.sequence_id):
        if run.kind == PROCESS and recording.id in recording_ids_of(run.arguments):
            raise recording_in_use(recording.id, run.id)
        if run.kind == EXPORT and recording.state == "registered":
            raise recording_in_use(recording.id, run.id)
        if run.kind == REGISTER and run.arguments["recording_id"] == recording.id:
            with suppress(JobStateError):  # the job ended while this transaction waited for its row
                cancel(session, run.id, "its recording was deleted")
    subject_ids = [recording.id, *(file.upload_id for file in recording.files if file.upload_id is not None)]
    session.execute(delete(Recording).where(Recording.id == recording.id))
    for subject_id in subject_ids:
        storage_quota.release(session, subject_id, "recording deleted")


def _consume_uploads(session: Session, upload_id: str, uploader_id: str, sequence_id: str) -> Upload:
    upload = consume(session, upload_id, uploader_id, PURPOSE)
    if upload.target_id not in ("", sequence_id):
        raise Refused(
            "wrong_upload_target",
            f"upload {upload_id} was declared for sequence {upload.target_id}, not for {sequence_id}",
        )
    return upload


def _recording_of(sequence: SequenceRow, uploads: list[Upload], name: str) -> Recording:
    """Return the row of a recording that consists of these files, which are sorted by name."""
    files = [
        RecordingFile(
            ordinal=ordinal,
            upload_id=upload.id,
            filename=upload.filename,
            size_bytes=upload.length_bytes,
            sha256=upload.sha256,
        )
        for ordinal, upload in enumerate(uploads)
    ]
    filename, digest = uploads[0].filename, uploads[0].sha256
    if len(uploads) > 1:
        check_bag_files([file.filename for file in files])
        filename, digest = name, whole_sha256((file.filename, file.sha256) for file in files)
    size_bytes = sum(file.size_bytes for file in files)
    return Recording(sequence_id=sequence.id, filename=filename, size_bytes=size_bytes, sha256=digest, files=files)


def _alive(session: Session, sequence_id: str) -> list[Job]:
    runs = select(Job).where(Job.sequence_id == sequence_id, Job.id == Job.root_id, Job.state.not_in(TERMINAL))
    return list(session.scalars(runs.execution_options(populate_existing=True)))


# Recordings located on this machine under their owners' names: stored recordings and recordings in place. A stored
# recording is identified by the objects of its files; locating it fetches its bytes. A recording in place is used in
# place if it matches its registration. The recordings of a run are located as the folder of a joined recording, which
# `joined.json` describes.


def kept_recording(session: Session, recording: Recording) -> StoredRecording:
    """Return the objects of its files, or its place."""
    files = tuple(_kept_file(session, file) for file in recording.files)
    return StoredRecording(recording.filename, files, recording_place(recording))


def recording_place(recording: Recording) -> RecordingPlace | None:
    """Return the place of a recording that is read in place, or None."""
    return None if recording.place is None else RecordingPlace.of_record(recording.place)


@contextmanager
def unchanged(platform: Platform, kept: Sequence[StoredRecording]) -> Iterator[None]:
    """Run a block that reads recordings, and check afterwards that they are unchanged.

    Raises, instead of the block's error, `recording_changed_in_place` or `recording_vanished` if a recording in place
    differs from its registration: its data must not be used. Raises `ObjectDamagedError` instead of a refusal if a
    stored recording differs from the uploaded file.
    """

    def check() -> None:
        for kept_place in (recording.place for recording in kept if recording.place is not None):
            refuse_changed(platform.settings.in_place, kept_place)

    stored = [file.object_key for recording in kept for file in recording.files]
    with checked_after(check), comparing(platform.store, platform.database, stored, "the recording"):
        yield


def locate(platform: Platform, kept: StoredRecording) -> Path:
    """Return the path of the bag on this machine, a file or a folder with its owner's name.

    Raises `recording_changed_in_place`, `recording_vanished`.
    """
    if kept.place is not None:
        refuse_changed(platform.settings.in_place, kept.place)
        if not is_by_ranges(platform.settings.in_place, kept.place):
            return located_in_place(platform.settings, kept.place)
    if len(kept.files) == 1:
        return locate_file(platform, kept.files[0])
    files = [(platform.store.local(file.object_key), file.filename) for file in kept.files]
    return named_folder(platform.settings.root / NAMES_FOLDER, files, kept.name)


def locate_run(platform: Platform, kept: Sequence[StoredRecording], described: Path) -> Path:
    """Return the path of a run's recordings as one bag; for several, the folder `described` contains `joined.json`.

    Raises `JoinedFileError` (BAG-040) if that file describes other recordings.
    """
    if len(kept) == 1:
        return locate(platform, kept[0])
    return locate_joined(platform, {recording.name: recording for recording in kept}, described)


def locate_joined(platform: Platform, kept: Mapping[str, StoredRecording], described: Path) -> Path:
    """Return the folder of a joined recording; `kept` are its members, by name. Raises as `locate_run`."""
    names = {member.name for member in read_joined(described)}
    if names != set(kept):
        problem = f"it joins {', '.join(sorted(names))}, but the run has {', '.join(sorted(kept))}"
        raise JoinedFileError(described.name, problem)
    bags = {name: locate(platform, recording) for name, recording in kept.items()}
    description = (JOINED, (described / JOINED).read_bytes())
    return described_folder(platform.settings.root / NAMES_FOLDER, bags, description, "joined")


def locate_file(platform: Platform, kept: StoredRecordingFile) -> Path:
    """Return the path of a local file with the object's bytes and the owner's file name."""
    return named(platform.settings.root / NAMES_FOLDER, platform.store.local(kept.object_key), kept.filename)


def _kept_file(session: Session, file: RecordingFile) -> StoredRecordingFile:
    """Return the file to read: its recovered version if it was truncated."""
    blob = session.get_one(Blob, file.recovered_blob_sha256 or file.blob_sha256)
    return StoredRecordingFile(blob.object_key, file.filename)
