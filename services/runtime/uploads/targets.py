"""Checks that an upload's target exists and belongs to its owner.

**Conventions.** A recording may name its sequence. A submission names its draft, which announced the very file: so what
a phase's frames bound is known before anything comes, and what comes can only be that.
"""

from services.runtime.orm import SequenceRow, SubmissionRow, TeamMember
from services.runtime.platform import Platform
from services.runtime.uploads.declaration import UploadDeclaration
from services.runtime.uploads.errors import UndeclaredUploadError, UploadTargetMissingError
from services.runtime.uploads.rows import UploadOwner

SUBMISSION = "submission"


def refuse_foreign_target(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> None:
    """Raises `UploadTargetMissingError`, `UndeclaredUploadError`."""
    if declared.purpose == SUBMISSION:
        _refuse_foreign_draft(platform, owner, declared)
    elif declared.purpose == "recording" and declared.target_id:
        _refuse_foreign_sequence(platform, owner, declared)


def _refuse_foreign_sequence(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> None:
    """A recording for a sequence that is not there would be found out only after hours of sending."""
    with platform.database.reading() as session:
        sequence = session.get(SequenceRow, declared.target_id)
    is_theirs = sequence is not None and (owner.is_administrator or sequence.owner_id == owner.user_id)
    if sequence is None or not is_theirs or sequence.deleted_ns is not None:
        raise UploadTargetMissingError(declared.purpose, declared.target_id)


def _refuse_foreign_draft(platform: Platform, owner: UploadOwner, declared: UploadDeclaration) -> None:
    """Only for a draft of a team that the owner belongs to, and only the file that it announces."""
    with platform.database.reading() as session:
        draft = session.get(SubmissionRow, declared.target_id)
        is_member = draft is not None and session.get(TeamMember, (draft.team_id, owner.user_id)) is not None
    if draft is None or not is_member or draft.state != "draft":
        raise UploadTargetMissingError(declared.purpose, declared.target_id)
    if declared.length_bytes != draft.size_bytes:
        raise UndeclaredUploadError("length", declared.length_bytes, draft.size_bytes)
    if declared.sha256 != draft.declared_sha256:
        raise UndeclaredUploadError("sha256", declared.sha256, draft.declared_sha256)
