"""Teams over the wire: their members, invitations, and the phases they take part in."""

from typing import Annotated

from fastapi import Path, Query
from pydantic import Field, StringConstraints

from api.schemas.base import PLAIN, Answer, Body, Instant, Reason, example
from api.schemas.people import UserName

SECRET_EXAMPLE = "invite_" + "x" * 43
LONGEST_S = 60 * 86_400

MemberName = Annotated[str, Path(pattern=r"^[a-z0-9._@+-]{1,64}$", examples=["ada"])]
ReasonQuery = Annotated[
    str,
    Query(pattern=PLAIN, max_length=500, description="Reason; required of administrators who do not lead the team."),
]


class InvitationBody(Body):
    """An invitation that one user may accept within `expires_s`."""

    model_config = example(expires_s=1209600)

    expires_s: Annotated[int, Field(ge=60, le=LONGEST_S)] = 14 * 86_400


class InvitationItem(Answer):
    """An invitation that is still open, without its secret."""

    model_config = example(expires_at="2026-05-17T09:12:44.120000Z")

    id: str
    created_at: Instant
    expires_at: Instant


class IssuedInvitation(InvitationItem):
    """An invitation with its secret, shown this once: hand it to whom it is meant for."""

    model_config = example(secret=SECRET_EXAMPLE)

    secret: str


class JoinBody(Body):
    """The secret of an invitation."""

    model_config = example(secret=SECRET_EXAMPLE)

    secret: Annotated[str, StringConstraints(max_length=200)]


class CaptainBody(Body):
    """The name of the new captain. `reason` is required of administrators who do not lead the team."""

    model_config = example(member="ada", reason="the captain left the institute")

    member: UserName
    reason: Reason | None = None
