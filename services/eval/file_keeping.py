"""Moves the file of a submission from its upload to the object store.

**Conventions.** It is kept under its own transaction, not with the job's success: the file that came in can then go,
and an attempt that is killed afterwards finds it kept.
"""

from contextlib import ExitStack, suppress
from pathlib import Path

from sqlalchemy import update
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions.submissions import mark_scoring
from services.eval.scoring_errors import UploadDamagedError
from services.runtime.orm import SubmissionRow, Upload
from services.runtime.platform import Platform
from services.runtime.store.blobs import PreparedBlob, link, prepare
from services.runtime.store.keys import ObjectMissingError
from services.runtime.uploads.backends import backend_of, remove_bytes


def keep_file(platform: Platform, submission: SubmissionRow) -> None:
    """Have the file as a blob, and the submission in scoring; nothing happens where that is so.

    Raises `UploadDamagedError`, `JobCancelledError` where it ended meanwhile, and what the store raises.
    """
    if submission.blob_sha256 is None:
        _keep(platform, submission)
    elif submission.state == "queued":  # an administrator has it tried again
        with platform.database.transaction() as session:
            mark_scoring(session, submission.id)
    if submission.upload_id:
        remove_bytes(platform, [submission.upload_id])


def _keep(platform: Platform, submission: SubmissionRow) -> None:
    declared = submission.declared_sha256
    with ExitStack() as copies:
        prepared = prepare(platform.store, platform.database, _received(platform, submission, copies), adopt=True)
        if prepared.sha256 != declared:
            raise UploadDamagedError(prepared.sha256, declared)
        with platform.database.transaction() as session:
            _write(session, submission.id, prepared)


def _received(platform: Platform, submission: SubmissionRow, copies: ExitStack) -> Path:
    """The file on this machine. Raises `UploadDamagedError` when it is gone."""
    with platform.database.reading() as session:
        upload = session.get(Upload, submission.upload_id or "")
    if upload is not None:
        with suppress(FileNotFoundError, ObjectMissingError):
            return copies.enter_context(backend_of(platform, upload).local(upload))
    raise UploadDamagedError("", submission.declared_sha256)


def _write(session: Session, submission_id: str, prepared: PreparedBlob) -> None:
    mark_scoring(session, submission_id)
    blob = link(session, prepared)
    unkept = update(SubmissionRow).where(SubmissionRow.id == submission_id, SubmissionRow.blob_sha256.is_(None))
    session.execute(unkept.values(blob_sha256=blob.sha256), execution_options={"synchronize_session": False})
