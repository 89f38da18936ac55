"""The stage that reads a recording once and keeps it: received → registered or refused.

    files → (what was cut off is recovered) → inspection → quality → previews → blobs → rows

**Conventions.** The uploads' files stay until blobs hold their bytes, so an attempt killed anywhere is repeated from
the start and makes the same; the sweeper removes the files afterwards. A refusal is written before the job fails by it,
in the same words.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from sqlalchemy.orm import Session

from services.ingest.bag import open_bag
from services.ingest.cut_files import RecoveredFile, recovered_files
from services.ingest.errors import CutBagError, IngestError
from services.ingest.inspection import Inspection, inspect
from services.ingest.inspection_record import inspection_record
from services.ingest.previews.pictures import previews_of
from services.ingest.quality.page import quality_page
from services.ingest.quality.report import Quality, quality_of
from services.ingest.received import Received, ReceivedFile, received
from services.ingest.recording_errors import RecordingChangedError
from services.runtime import quota
from services.runtime.blobs import PreparedBlob, link_all, prepare
from services.runtime.errors import PlatformFaultError
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Recording
from services.runtime.platform import Platform
from services.runtime.previews import PreparedPreview, Shown, prepared_previews, replace_previews
from services.runtime.workspace import Workspace
from stone.errors import StoneError
from stone.findings import Finding

QUALITY_RECORD, QUALITY_PAGE = "quality.json", "quality.html"
STEPS = 4


@dataclass(frozen=True)
class _Seen:
    """What was seen in the bag; `recovered` is read in the place of what was cut off."""

    inspection: Inspection
    quality: Quality
    recovered: Mapping[str, RecoveredFile]
    pictures: tuple[tuple[str, str, bytes], ...]


@dataclass(frozen=True)
class _Kept:
    """The stored bytes: of each file and of what was recovered of it by the file's row, and of the previews."""

    originals: Mapping[str, PreparedBlob]
    recovered: Mapping[str, PreparedBlob]
    previews: tuple[PreparedPreview, ...]

    def blobs(self) -> list[PreparedBlob]:
        return [*self.originals.values(), *self.recovered.values(), *(preview.blob for preview in self.previews)]


def register(platform: Platform, attempt: Attempt) -> Outcome:
    """Inspect the recording and keep it as blobs. Raises the `BAG-*` refusals, `RecordingChangedError`."""
    brought = received(platform, str(attempt.arguments["recording_id"]))
    work = Workspace(platform.store, platform.settings, attempt.root_id).folder
    attempt.progress("inspect", 0, STEPS)
    try:
        seen = _seen(brought, work, attempt)
        attempt.progress("keep", 2, STEPS)
        originals = {file.row_id: _prepared(platform, file) for file in brought.files}
    except PlatformFaultError:  # a disk that is full, a store that is away: no fault of the recording
        raise
    except (IngestError, RecordingChangedError) as error:
        _refuse(platform, brought, error)
        raise
    attempt.progress("keep", 3, STEPS)
    recovered = {
        row_id: prepare(platform.store, platform.database, file.path, adopt=True)
        for row_id, file in seen.recovered.items()
    }
    kept = _Kept(originals, recovered, prepared_previews(platform, work, _drawn(brought.name, seen)))
    attempt.progress("keep", STEPS, STEPS)
    topics, findings = len(seen.inspection.topics), len(seen.inspection.findings)
    attempt.log("inspected", topics=topics, findings=findings, score=seen.quality.score, recovered=len(recovered))
    result = {"recording_id": brought.recording_id, "topics": topics, "score": seen.quality.score}
    return Outcome(result, commit=lambda session: _register(session, brought, seen, kept))


def _seen(brought: Received, work: Path, attempt: Attempt) -> _Seen:
    path, recovered = brought.bag(), {}
    try:
        inspection = inspect(path, brought.profile)
    except CutBagError:
        recovered = recovered_files(brought, work / "recovered")
        if not recovered:
            raise
        path = brought.bag({row_id: file.path for row_id, file in recovered.items()})
        inspection = inspect(path, brought.profile)
    said = tuple(file.finding for file in recovered.values())
    inspection = replace(inspection, findings=(*said, *inspection.findings))
    attempt.progress("measure", 1, STEPS)
    with open_bag(path) as bag:
        quality = quality_of(bag, inspection)
        return _Seen(inspection, quality, recovered, tuple(previews_of(bag, inspection)))


def _drawn(name: str, seen: _Seen) -> tuple[tuple[str, str, bytes], ...]:
    """The previews, with the quality for programs and for people."""
    record = json.dumps(seen.quality.as_record(), indent=1, allow_nan=False).encode()
    page = quality_page(name, seen.inspection, seen.quality, seen.pictures)
    return ((QUALITY_RECORD, "application/json", record), (QUALITY_PAGE, "text/html", page), *seen.pictures)


def _prepared(platform: Platform, file: ReceivedFile) -> PreparedBlob:
    """Raises `RecordingChangedError`."""
    prepared = prepare(platform.store, platform.database, file.path, adopt=True)
    if prepared.sha256 != file.sha256:
        raise RecordingChangedError(file.filename, prepared.sha256, file.sha256)
    return prepared


def _register(session: Session, brought: Received, seen: _Seen, kept: _Kept) -> None:
    recording = session.get(Recording, brought.recording_id, with_for_update=True)
    if recording is None:
        raise JobCancelledError("its recording was deleted")
    link_all(session, kept.blobs())
    for file in recording.files:
        file.blob_sha256 = kept.originals[file.id].sha256
        file.recovered_blob_sha256 = kept.recovered[file.id].sha256 if file.id in kept.recovered else None
    record = inspection_record(seen.inspection)
    recording.state = "registered"
    recording.findings = record.pop("findings")
    recording.inspection, recording.quality = record, seen.quality.as_record()
    replace_previews(session, Shown(recording.sequence_id, recording.id), kept.previews)


def _refuse(platform: Platform, brought: Received, error: StoneError) -> None:
    """Write the refusal down, give the owner's bytes back, remove the files."""
    with platform.database.transaction() as session:
        recording = session.get(Recording, brought.recording_id, with_for_update=True)
        if recording is None or recording.state != "received":
            return
        recording.state = "refused"
        recording.findings = [Finding(error.code, "error", "", str(error)[:2000]).as_record()]
        for file in brought.files:
            quota.release(session, file.upload_id, "recording refused")
    for file in brought.files:
        file.path.unlink(missing_ok=True)
