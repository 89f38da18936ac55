"""Recordings over the wire."""

from datetime import datetime
from typing import Any

from api.schemas.base import ID_EXAMPLE, SHA256_EXAMPLE, Answer, Body, IdText, example
from api.schemas.calibrations import FindingItem
from api.schemas.jobs import JOB_EXAMPLE, JobItem

RECORDING_EXAMPLE: dict[str, Any] = {
    "id": ID_EXAMPLE,
    "sequence_id": ID_EXAMPLE,
    "upload_id": ID_EXAMPLE,
    "filename": "run.mcap",
    "size_bytes": 8123456789,
    "sha256": SHA256_EXAMPLE,
    "state": "registered",
    "findings": [],
    "created_at": "2026-05-03T09:12:44.120000Z",
}


class NewRecordingBody(Body):
    """A complete upload that is to become a recording; an upload becomes one recording and no more."""

    model_config = example(upload_id=ID_EXAMPLE)

    upload_id: IdText


class RecordingItem(Answer):
    """One bag of a sequence. `state`: received, registered (read and kept), refused (see `findings`)."""

    model_config = example(**RECORDING_EXAMPLE)

    id: str
    sequence_id: str
    upload_id: str | None
    filename: str
    size_bytes: int
    sha256: str
    state: str
    findings: list[FindingItem]
    created_at: datetime


class RecordingDetail(RecordingItem):
    """A recording with what its inspection said: topics, roles, clocks (null until it is registered)."""

    model_config = example(**RECORDING_EXAMPLE, inspection={"topics": []})

    inspection: dict[str, Any] | None


class RecordingAccepted(Answer):
    """The recording as it stands, and the job that reads it."""

    model_config = example(recording=RECORDING_EXAMPLE, job={**JOB_EXAMPLE, "kind": "ingest.register"})

    recording: RecordingItem
    job: JobItem
