"""Submissions of a team, as rows: a draft with the upload that it announced, and one that is settled."""

from hashlib import sha256

from services.domain.benchmarks.submissions.submissions import SubmissionDraft, create_draft
from services.runtime.orm import SubmissionRow, new_id
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.worlds import made


def submitted(platform: Platform, phase_id: str, team_id: str, owner: Person) -> dict[str, str]:
    """The ids of a draft, of its complete upload, and of a submission that was found invalid."""
    content = new_id().encode()
    said = SubmissionDraft(
        phase_id=phase_id,
        team_id=team_id,
        user_id=owner.user_id,
        kind="entry",
        method="Net",
        description="",
        modality="L",
        sha256=sha256(content).hexdigest(),
        size_bytes=len(content),
    )
    with platform.database.transaction() as session:
        draft = create_draft(session, said).id
        settled = SubmissionRow(phase_id=phase_id, team_id=team_id, user_id=owner.user_id, method="Net", modality="L")
        settled.declared_sha256, settled.size_bytes, settled.state = "0" * 64, 1, "invalid"
        settled.finalized_ns, settled.settled_ns = now_ns(), now_ns()
        session.add(settled)
        session.flush()
        settled_id = settled.id
    upload = made.upload(platform, owner, content, purpose="submission", target_id=draft)
    return {"submission_id": draft, "submission_upload": upload, "settled_submission": settled_id}
