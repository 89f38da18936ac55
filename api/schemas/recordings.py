"""Recordings over the wire."""

from datetime import datetime
from typing import Any

from api.schemas.base import ID_EXAMPLE, SHA256_EXAMPLE, Answer, Body, IdText, example
from api.schemas.calibrations import FindingItem


class NewRecordingBody(Body):
    """A complete upload that is to become a recording; an upload becomes one recording and no more."""

    model_config = example(upload_id=ID_EXAMPLE)

    upload_id: IdText


class RecordingItem(Answer):
    """One bag of a sequence. `state`: received, registered (read and kept), refused (see `findings`)."""

    model_config = example(
        id=ID_EXAMPLE,
        sequence_id=ID_EXAMPLE,
        upload_id=ID_EXAMPLE,
        filename="run.mcap",
        size_bytes=8123456789,
        sha256=SHA256_EXAMPLE,
        state="registered",
        findings=[],
        created_at="2026-05-03T09:12:44.120000Z",
    )

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

    inspection: dict[str, Any] | None
