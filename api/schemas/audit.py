"""The audit log over the wire."""

from typing import Any

from api.schemas.base import SHA256_EXAMPLE, Answer, Instant, example


class AuditLine(Answer):
    """Actor, act, subject and reason; `hash` links the line to the previous line."""

    model_config = example(
        number=17,
        actor="ada",
        act="user.change",
        reason="leads the next campaign",
        facts={"role": "curator"},
        request_id="4d1f0a9b",
        hash=SHA256_EXAMPLE,
    )

    number: int
    actor_id: str
    actor: str
    act: str
    subject_id: str
    reason: str
    facts: dict[str, Any]
    request_id: str
    logged_at: Instant
    hash: str


class AuditVerification(Answer):
    """Whether every line follows from the one before; `head_hash` is worth noting elsewhere."""

    model_config = example(is_whole=True, lines=17, head_hash=SHA256_EXAMPLE)

    is_whole: bool
    first_broken: int | None
    lines: int
    head_hash: str


class ProblemItem(Answer):
    """A kind of refusal."""

    model_config = example(code="not_found", status=404, title="Not found, or no access")

    code: str
    status: int
    title: str
