"""Create uploads: space for the bytes first, then the row and its quota.

**Conventions.** The sweeper deletes bytes without a row (`expiry`); each row has its bytes in a backend. If the owner
has the declared file already, the new upload shares its bytes and is complete at once. Other owners' files are never
compared, so an upload reveals nothing about them.
"""

import re
import unicodedata
from dataclasses import dataclass

from sqlalchemy import ColumnElement, func, literal_column, select
from sqlalchemy.orm import Session

from services.runtime.access.storage_quota import reserve
from services.runtime.orm import SequenceRow, SubmissionRow, TeamMember, Upload, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from services.runtime.store.free_space import require_room
from services.runtime.uploads.backends import backend_of
from services.runtime.uploads.errors import BadMetadataError, upload_too_large
from services.runtime.uploads.rows import PART, UploadOwner, expiry_ns, is_waiting
from stone.errors import Refused, StoneError

# The client's declaration of a file to upload, validated.
#
# **Conventions.** All fields come from outside and are never repaired: a bad name is refused, so the platform shows
# exactly the owner's name.


FOLDER = "folder"
PURPOSES = ("recording", "calibration", "submission", "ground_truth", "dataset")
LONGEST_NAME_BYTES = 255
SHA256 = re.compile(r"[0-9a-f]{64}")
TARGET = re.compile(r"[A-Za-z0-9_-]{0,64}")
UNSEEN = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")


@dataclass(frozen=True)
class UploadDeclaration:
    """A file to upload. `sha256` and `target_id` may be empty. The constructor raises `BadMetadataError`."""

    filename: str
    purpose: str
    length_bytes: int
    target_id: str = ""
    sha256: str = ""

    def __post_init__(self) -> None:
        check_filename(self.filename)
        if self.purpose not in (*PURPOSES, PART):
            raise BadMetadataError("purpose", self.purpose, f"one of {', '.join(PURPOSES)}")
        if not TARGET.fullmatch(self.target_id):
            raise BadMetadataError("target_id", self.target_id, "an id of at most 64 letters, digits, _ and -")
        if self.sha256 and not SHA256.fullmatch(self.sha256):
            raise BadMetadataError("sha256", self.sha256, "64 lowercase hex digits")


def check_filename(name: str) -> None:
    """Raise `BadMetadataError` unless the name is one path component, printable, at most 255 bytes."""
    if not name.strip() or name in (".", ".."):
        raise BadMetadataError("filename", name, "the name of a file")
    if len(name.encode("utf-8", "surrogatepass")) > LONGEST_NAME_BYTES:
        raise BadMetadataError("filename", name, f"at most {LONGEST_NAME_BYTES} bytes of UTF-8")
    if "/" in name or "\\" in name:
        raise BadMetadataError("filename", name, "a name without folders")
    if any(unicodedata.category(character) in UNSEEN for character in name):
        raise BadMetadataError("filename", name, "no control, formatting or unassigned characters")


def create(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> Upload:
    """Create an upload: open, or complete if the owner has these bytes already.

    Raises `upload_too_large`, `upload_target_missing`, `not_as_announced`, `too_many_uploads_of_draft`,
    `quota_exceeded`, `too_many_uploads`, `DiskFullError`, `StorageFullError`.
    """
    limit_bytes = platform.settings.uploads.max_bytes
    if declared.length_bytes > limit_bytes:
        raise upload_too_large(declared.length_bytes, limit_bytes)
    refuse_foreign_target(platform, owner, declared)
    upload = new_upload(platform, owner, declared, declared.length_bytes)
    backend = backend_of(platform, upload)
    is_here = backend.begin(upload)
    try:
        with platform.database.transaction() as session:
            hold_draft(session, platform.settings, declared)
            limit_bytes = owner_limit_bytes(platform, owner)
            reserve(session, owner.user_id, upload.length_bytes, upload.id, "upload", limit_bytes)  # locks the owner
            refuse_too_many(session, platform.settings, owner)
            session.add(upload)
            session.flush()
            if is_here or backend.enter(session, upload):
                upload.state, upload.sha256 = "complete", declared.sha256
            elif upload.backend == FOLDER or not platform.settings.store.s3_bucket:
                reserve_bytes = platform.settings.store.reserve_bytes
                require_room(platform.settings.uploads_folder, declared.length_bytes, reserve_bytes)
    except StoneError:  # after any other error (such as a lost reply to COMMIT) the row may exist and need its bytes
        backend.remove(upload.id)
        raise
    return upload


def owner_limit_bytes(platform: Platform, owner: UploadOwner) -> int:
    """Return the owner's storage limit in bytes, for stored and unfinished files together."""
    settings = platform.settings
    return settings.submissions.participant_bytes if owner.is_participant else settings.uploads.owner_bytes


def new_upload(platform: Platform, owner: UploadOwner, declared: UploadDeclaration, length_bytes: int) -> Upload:
    """Return an open upload that is not in a session yet."""
    return Upload(
        id=new_id(),
        owner_id=owner.user_id,
        purpose=declared.purpose,
        target_id=declared.target_id,
        backend=platform.settings.uploads.backend,
        filename=declared.filename,
        length_bytes=length_bytes,
        declared_sha256=declared.sha256,
        state="open",
        sha256="",
        detail="",
        created_ns=now_ns(),
        expires_ns=expiry_ns(platform),
    )


# Check that an upload's target exists and belongs to its owner.
#
# **Conventions.** A recording may name its sequence. A submission names its draft, which announced this file. The
# platform can therefore check the announcement against the phase's frames before any bytes arrive.


SUBMISSION = "submission"


def refuse_foreign_target(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> None:
    """Raise `upload_target_missing`, `not_as_announced`."""
    if declared.purpose == SUBMISSION:
        _refuse_foreign_draft(platform, owner, declared)
    elif declared.purpose == "recording" and declared.target_id:
        _refuse_foreign_sequence(platform, owner, declared)


def _refuse_foreign_sequence(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> None:
    """Raise an error if the recording's sequence does not exist, before hours of uploading."""
    with platform.database.reading() as session:
        sequence = session.get(SequenceRow, declared.target_id)
    is_theirs = sequence is not None and (owner.is_administrator or sequence.owner_id == owner.user_id)
    if sequence is None or not is_theirs or sequence.deleted_ns is not None:
        raise upload_target_missing(declared.purpose, declared.target_id)


def _refuse_foreign_draft(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> None:
    """Require a draft of the owner's team that announces exactly this file."""
    with platform.database.reading() as session:
        draft = session.get(SubmissionRow, declared.target_id)
        is_member = draft is not None and session.get(TeamMember, (draft.team_id, owner.user_id)) is not None
    if draft is None or not is_member or draft.state != "draft":
        raise upload_target_missing(declared.purpose, declared.target_id)
    if declared.length_bytes != draft.size_bytes:
        raise undeclared_upload("length", declared.length_bytes, draft.size_bytes)
    if declared.sha256 != draft.declared_sha256:
        raise undeclared_upload("sha256", declared.sha256, draft.declared_sha256)


# Limits on waiting uploads: per owner, and per draft of a submission.
#
# **Conventions.** An upload waits from its creation until it is used or ends. Its transaction counts the waiting
# uploads under the locks of its draft and then of its owner, so concurrent requests cannot exceed the limit. Overdue
# uploads count until they are swept.


def hold_draft(session: Session, settings: Settings, declared: UploadDeclaration) -> None:
    """Lock the submission's draft and check that it may have one more waiting upload.

    Raises `upload_target_missing` if the draft was deleted or finalised meanwhile, `too_many_uploads_of_draft`.
    """
    if declared.purpose != SUBMISSION:
        return
    draft = select(SubmissionRow.state).where(SubmissionRow.id == declared.target_id).with_for_update(key_share=True)
    if session.scalar(draft) != "draft":
        raise upload_target_missing(declared.purpose, declared.target_id)
    limit = settings.submissions.draft_waiting
    if _count_waiting(session, Upload.target_id == declared.target_id, limit) >= limit:
        raise Refused(
            "too_many_uploads_of_draft",
            f"the draft {declared.target_id[:64]!r} has {limit} unfinished or unused uploads, which is the limit; "
            "resume one of these uploads, or delete the abandoned ones",
        )


def refuse_too_many(session: Session, settings: Settings, owner: UploadOwner) -> None:
    """Raise `too_many_uploads` if the owner, whose row the caller has locked, may have no further upload."""
    limit = settings.submissions.participant_waiting if owner.is_participant else settings.uploads.owner_waiting
    if _count_waiting(session, Upload.owner_id == owner.user_id, limit) >= limit:
        raise Refused(
            "too_many_uploads",
            f"you have {limit} unfinished or unused uploads, which is the limit; resume, use or delete uploads "
            "(GET /api/v1/uploads), or wait until they expire",
        )


def _count_waiting(session: Session, among: ColumnElement[bool], most: int) -> int:
    """Return the number of waiting uploads among these, at most `most`."""
    some = select(literal_column("1")).select_from(Upload).where(among, is_waiting()).limit(most).subquery()
    return session.scalar(select(func.count()).select_from(some)) or 0


def upload_target_missing(purpose: str, target_id: str) -> Refused:
    return Refused("upload_target_missing", f"you have no target {target_id[:64]!r} for a {purpose}; create it first")


def undeclared_upload(field: str, given: object, announced: object) -> Refused:
    return Refused(
        "not_as_announced",
        f"{field} is {str(given)[:80]!r}, but the draft announces {str(announced)!r}; "
        "if the zip has changed since, create a new draft",
    )
