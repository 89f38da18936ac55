"""Exports over the wire: a sequence's labels in a format that others open."""

from typing import Literal

from api.schemas.base import SHA256_EXAMPLE, Answer, Body, Instant, example, example_of
from api.schemas.jobs import FailureItem, JobItem
from services.domain.exports.requests import ExportFormat

ArchiveKind = Literal["tar", "zip"]


class NewExportBody(Body):
    """In which format the labels that count are wanted."""

    model_config = example(format="nuscenes")

    format: ExportFormat


class ArchiveItem(Answer):
    """All files of an export in one file, at `archive?format=…`."""

    model_config = example(format="tar", size_bytes=48210432)

    format: ArchiveKind
    size_bytes: int
    sha256: str


class ExportItem(Answer):
    """An export; its files and archives are there once its state is `succeeded`.

    It is stale when other labels of the sequence count by now: it stays as it is until it is deleted.
    """

    model_config = example(
        format="nuscenes",
        state="succeeded",
        is_stale=False,
        recipe=SHA256_EXAMPLE,
        code_version="71299b6a455d",
        files=13216,
        size_bytes=41003421,
        failure=None,
        created_at="2026-05-03T10:31:02.250000Z",
        finished_at="2026-05-03T10:33:40Z",
    )

    id: str
    sequence_id: str
    label_set_id: str
    job_id: str
    format: ExportFormat
    state: str
    is_stale: bool
    recipe: str
    code_version: str
    files: int
    size_bytes: int
    archives: list[ArchiveItem]
    failure: FailureItem | None
    created_at: Instant
    finished_at: Instant | None


class ExportAccepted(Answer):
    """The requested export, and the job that makes it or has made it."""

    model_config = example(job=example_of(JobItem) | {"kind": "labeler.export"})

    export: ExportItem
    job: JobItem


class ExportFileItem(Answer):
    """One file of an export; its bytes are at `files/{path}`."""

    model_config = example(path="v1.0-trainval/sample.json", size_bytes=152034)

    path: str
    size_bytes: int
    sha256: str
