"""Uploads over the wire."""

from api.schemas.base import Answer, Instant, example
from services.runtime.orm import Upload


class UploadItem(Answer):
    """An upload. `state`: open, complete, consumed, failed, expired, terminated; `detail` is the reason of a failure.

    `offset_bytes` is the number of bytes received, `sha256` the computed hash once it is complete.
    """

    model_config = example(
        purpose="recording",
        filename="run.mcap",
        length_bytes=8123456789,
        offset_bytes=123456789,
        sha256=None,
        state="open",
        detail="",
        expires_at="2026-05-10T09:12:44.120000Z",
    )

    id: str
    purpose: str
    target_id: str | None
    filename: str
    length_bytes: int
    offset_bytes: int
    sha256: str | None
    declared_sha256: str | None
    state: str
    detail: str
    created_at: Instant
    expires_at: Instant


def upload_item(upload: Upload, offset_bytes: int) -> UploadItem:
    return UploadItem.of(
        upload,
        target_id=upload.target_id or None,
        offset_bytes=offset_bytes,
        sha256=upload.sha256 or None,
        declared_sha256=upload.declared_sha256 or None,
    )
