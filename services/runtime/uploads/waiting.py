"""Limits on how many uploads may wait: of one owner, and for one draft of a submission.

**Conventions.** An upload waits from its creation until it is used or ends, whether its bytes have come or not. It is
counted in the transaction that makes it, under the locks of its draft and of its owner, in this order, so that of two
at once only one takes the last place. What is overdue counts until it is swept, as its bytes do.
"""

from sqlalchemy import ColumnElement, func, literal_column, select
from sqlalchemy.orm import Session

from services.runtime.orm import SubmissionRow, Upload
from services.runtime.settings import Settings
from services.runtime.uploads.declaration import UploadDeclaration
from services.runtime.uploads.errors import (
    TooManyUploadsError,
    TooManyUploadsOfDraftError,
    UploadTargetMissingError,
)
from services.runtime.uploads.rows import UploadOwner, is_waiting
from services.runtime.uploads.targets import SUBMISSION


def hold_draft(session: Session, settings: Settings, declared: UploadDeclaration) -> None:
    """Lock the draft that a submission is for, for which one more may wait.

    Raises `UploadTargetMissingError` for one that went or was finalised meanwhile, `TooManyUploadsOfDraftError`.
    """
    if declared.purpose != SUBMISSION:
        return
    draft = select(SubmissionRow.state).where(SubmissionRow.id == declared.target_id).with_for_update(key_share=True)
    if session.scalar(draft) != "draft":
        raise UploadTargetMissingError(declared.purpose, declared.target_id)
    limit = settings.submissions.draft_waiting
    if _waiting(session, Upload.target_id == declared.target_id, limit) >= limit:
        raise TooManyUploadsOfDraftError(declared.target_id, limit)


def refuse_too_many(session: Session, settings: Settings, owner: UploadOwner) -> None:
    """The owner, whose row the caller has locked, may have one more. Raises `TooManyUploadsError`."""
    limit = settings.submissions.participant_waiting if owner.is_participant else settings.uploads.owner_waiting
    if _waiting(session, Upload.owner_id == owner.user_id, limit) >= limit:
        raise TooManyUploadsError(limit)


def _waiting(session: Session, among: ColumnElement[bool], most: int) -> int:
    """How many of these wait, none counted beyond `most`."""
    some = select(literal_column("1")).select_from(Upload).where(among, is_waiting()).limit(most).subquery()
    return session.scalar(select(func.count()).select_from(some)) or 0
