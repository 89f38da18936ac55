"""The stage that reads a recording once and stores it: received → registered or refused.

    files → (truncated files are recovered) → inspection → quality → previews → blobs → rows
    files in place, or an excerpt of an object → inspection → quality → previews → rows

**Conventions.** The uploads' files stay until blobs hold their bytes, so an attempt killed anywhere is repeated from
the start with the same result; the sweeper deletes the files afterwards. A sandboxed child does all the reading
(`seeing`) while the files are hashed. If its reader crashes, only the job fails, and the recording stays received. A
refusal is written, in the same words, before it fails the job.
"""

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy.orm import Session

from services.domain.sequences.previews import PreparedPreview, PreviewSubject, prepared_previews, replace_previews
from services.domain.sequences.recordings import keep_excerpt, recording_place, unchanged
from services.domain.sequences.unusable_labels import record_unusable
from services.ingest.errors import RecordingChangedError
from services.ingest.excerpt import ExcerptMaker
from services.ingest.kernel_warmup import warm
from services.ingest.sandboxed_inspection import RECOVERED, STEPS, ReceivedBag, RecordingSurvey, received, seen
from services.runtime.access import storage_quota
from services.runtime.in_place.folders import located_in_place
from services.runtime.in_place.places import found_place, is_by_ranges, sha256_in_place
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Recording
from services.runtime.platform import Platform
from services.runtime.sandbox.job_sandbox import JobSandbox, private_folder_in
from services.runtime.store.blobs import PreparedBlob, hashed_beside, link_all, prepare, prepare_all, prepare_hashed
from services.runtime.store.own_names import without_paths
from services.runtime.store.workspace import Workspace
from services.runtime.uploads.backends import remove_bytes
from stone.errors import PlatformFaultError, Refused, StoneError
from stone.findings import Finding
from stone_recordings.bags.errors import IngestError
from stone_recordings.sync.stored_recording import RecordingPlace, StoredRecording

EXCERPT = "excerpt"


@dataclass(frozen=True)
class _StoredBytes:
    """Blobs of each file and of its recovered version, by the file's row, and the previews."""

    originals: Mapping[str, PreparedBlob]
    recovered: Mapping[str, PreparedBlob]
    previews: tuple[PreparedPreview, ...]

    def blobs(self) -> list[PreparedBlob]:
        return [*self.originals.values(), *self.recovered.values(), *(preview.blob for preview in self.previews)]


def register(platform: Platform, attempt: Attempt) -> Outcome:
    """Inspect the recording and store it as blobs.

    Raises the `BAG-*` refusals, `RecordingChangedError`, what `seen` raises.
    """
    if source_place := _place_of(platform, str(attempt.arguments["recording_id"])):
        return _read_in_place(platform, attempt, source_place)
    with received(platform, str(attempt.arguments["recording_id"])) as brought:
        return _read_and_kept(platform, attempt, brought)


def _place_of(platform: Platform, recording_id: str) -> RecordingPlace | None:
    with platform.database.reading() as session:
        recording = session.get(Recording, recording_id)
        return None if recording is None else recording_place(recording)


def _read_in_place(platform: Platform, attempt: Attempt, requested: RecordingPlace) -> Outcome:
    """Inspect a recording in place. Only previews are stored, and an excerpt of an object."""
    recording_id = str(attempt.arguments["recording_id"])
    work = Workspace(platform.store, platform.settings, attempt.root_id).folder
    attempt.progress("inspect", 0, STEPS)
    try:
        source_place = found_place(platform.settings.in_place, requested)
        with unchanged(platform, [StoredRecording(source_place.name, (), source_place)]):
            bag, parts = _at_hand(platform, attempt, source_place, work)
            with received(platform, recording_id, bag) as brought:
                survey = _survey_recording(platform, attempt, brought, work)
    except PlatformFaultError:
        raise
    except (IngestError, Refused) as error:
        _refuse(platform, recording_id, error)
        raise
    excerpt = list(prepare_all(platform.store, platform.database, parts, adopt=True))
    originals = {blob.sha256: blob for blob in excerpt}
    kept = _StoredBytes(originals, {}, prepared_previews(platform, work, survey.drawn))
    attempt.progress("keep", STEPS, STEPS)
    attempt.log("inspected", topics=survey.topics, findings=survey.findings, score=survey.quality["score"], recovered=0)
    result = {"recording_id": recording_id, "topics": survey.topics, "score": survey.quality["score"]}

    def commit(session: Session) -> None:
        recording = _register(session, brought, survey, kept)
        recording.place, recording.size_bytes = source_place.as_record(), source_place.size_bytes
        recording.sha256 = sha256_in_place(source_place, survey.content_sha256)
        keep_excerpt(session, platform.settings, recording, excerpt)

    return Outcome(result, commit=commit)


def _at_hand(
    platform: Platform, attempt: Attempt, source_place: RecordingPlace, work: Path
) -> tuple[Path, tuple[Path, ...]]:
    """Return the local bag, and its files: the recording in place (no files), or an excerpt."""
    if not is_by_ranges(platform.settings.in_place, source_place):
        return located_in_place(platform.settings, source_place), ()
    folder = work / EXCERPT / source_place.name
    shutil.rmtree(folder, ignore_errors=True)  # from an interrupted attempt
    folder.mkdir(parents=True)
    parts, read_bytes = ExcerptMaker(platform, attempt, source_place, folder).made()
    attempt.log("fetched", read_bytes=read_bytes, size_bytes=source_place.size_bytes, files=len(parts))
    if len(parts) == 1:
        named = folder / source_place.name
        parts[0].replace(named)
        return named, (named,)
    return folder, parts


def _read_and_kept(platform: Platform, attempt: Attempt, brought: ReceivedBag) -> Outcome:
    work = Workspace(platform.store, platform.settings, attempt.root_id).folder
    attempt.progress("inspect", 0, STEPS)
    try:
        with hashed_beside(platform.store, [file.path for file in brought.files], adopt=True) as hashed:
            try:
                survey = _survey_recording(platform, attempt, brought, work)
            except IngestError:  # a file damaged during transfer must not be reported as corrupt
                _refuse_changed(brought, hashed())
                raise
            attempt.progress("keep", 2, STEPS)
            originals = _originals(platform, brought, hashed())
    except PlatformFaultError:  # a full disk or unavailable store is not the recording's fault
        raise
    except (IngestError, RecordingChangedError) as error:
        _refuse(platform, brought.recording_id, error)
        raise
    attempt.progress("keep", 3, STEPS)
    recovered = {
        row_id: prepare(platform.store, platform.database, path, adopt=True)
        for row_id, path in survey.recovered.items()
    }
    kept = _StoredBytes(originals, recovered, prepared_previews(platform, work, survey.drawn))
    attempt.progress("keep", STEPS, STEPS)
    score = survey.quality["score"]
    attempt.log("inspected", topics=survey.topics, findings=survey.findings, score=score, recovered=len(recovered))
    result = {"recording_id": brought.recording_id, "topics": survey.topics, "score": score}

    def commit(session: Session) -> None:
        _register(session, brought, survey, kept)

    return Outcome(result, commit=commit)


def _survey_recording(platform: Platform, attempt: Attempt, brought: ReceivedBag, work: Path) -> RecordingSurvey:
    """Survey the recording; recovered files are then in `work` until the run is collected."""
    with private_folder_in(work) as folder:
        apart = JobSandbox(folder, brought.reads, attempt, platform.settings, warm, makes_links=True)
        survey = seen(brought, apart)
        return replace(
            survey, recovered={row_id: _move_recovered(path, work) for row_id, path in survey.recovered.items()}
        )


def _move_recovered(path: Path, work: Path) -> Path:
    target = work / RECOVERED / path.name
    target.parent.mkdir(exist_ok=True)
    return path.replace(target)


def _originals(platform: Platform, brought: ReceivedBag, hashed: Sequence[PreparedBlob]) -> dict[str, PreparedBlob]:
    """Return the stored files by their rows. Raises `RecordingChangedError`."""
    _refuse_changed(brought, hashed)
    stored = prepare_hashed(platform.database, hashed)
    return {file.row_id: blob for file, blob in zip(brought.files, stored, strict=True)}


def _refuse_changed(brought: ReceivedBag, hashed: Sequence[PreparedBlob]) -> None:
    """Raise `RecordingChangedError` if a hash differs from the uploaded file's."""
    for file, blob in zip(brought.files, hashed, strict=True):
        if blob.sha256 != file.sha256:
            raise RecordingChangedError(file.filename, blob.sha256, file.sha256)


def _register(session: Session, brought: ReceivedBag, survey: RecordingSurvey, kept: _StoredBytes) -> Recording:
    recording = session.get(Recording, brought.recording_id, with_for_update=True)
    if recording is None:
        raise JobCancelledError("its recording was deleted")
    link_all(session, kept.blobs())
    for file in recording.files:
        file.blob_sha256 = kept.originals[file.id].sha256
        file.recovered_blob_sha256 = kept.recovered[file.id].sha256 if file.id in kept.recovered else None
    inspection = dict(survey.inspection)
    recording.state = "registered"
    recording.findings = inspection.pop("findings")
    recording.inspection, recording.quality = inspection, survey.quality
    replace_previews(session, PreviewSubject(recording.sequence_id, recording.id), kept.previews)
    record_unusable(session, recording.sequence_id, recording.findings)
    return recording


def _refuse(platform: Platform, recording_id: str, error: StoneError) -> None:
    """Write the refusal, release the owner's bytes, delete the files."""
    with platform.database.transaction() as session:
        recording = session.get(Recording, recording_id, with_for_update=True)
        if recording is None or recording.state != "received":
            return
        recording.state = "refused"
        recording.findings = [Finding(error.code, "error", "", without_paths(str(error))[:2000]).as_record()]
        upload_ids = [file.upload_id for file in recording.files if file.upload_id]
        for upload_id in upload_ids:
            storage_quota.release(session, upload_id, "recording refused")
    remove_bytes(platform, upload_ids)
