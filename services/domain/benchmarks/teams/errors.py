"""Errors of founding, joining, leaving and leading teams."""

from stone.errors import StoneError


class AlreadyInTeamError(StoneError):
    """Somebody takes part in the phase with another team already."""

    code = "already_in_team"

    def __init__(self, phase: str) -> None:
        super().__init__(
            f"somebody of this team takes part in phase {phase!r} with another team; "
            "only one team per person and phase is allowed"
        )


class AlreadyMemberError(StoneError):
    """The user is a member of the team."""

    code = "already_member"

    def __init__(self, user: str) -> None:
        super().__init__(f"{user!r} is a member of this team already; the invitation stays as it was")


class InvitationError(StoneError):
    """The invitation is unknown, used, withdrawn or too old."""

    code = "no_invitation"

    def __init__(self) -> None:
        super().__init__(
            "this invitation is unknown, was used or withdrawn, or is too old; ask the captain for another"
        )


class TeamFullError(StoneError):
    """The team has as many members as it may have."""

    code = "team_full"

    def __init__(self, members: int, most: int) -> None:
        super().__init__(f"the team has {members} member(s), and {most} at most may take part where it does")


class TooManyError(StoneError):
    """Too many teams or invitations."""

    code = "too_many"

    def __init__(self, kind: str, most: int) -> None:
        super().__init__(f"there are {most} {kind} already, which is the limit; remove some that are not needed")


class NotCaptainError(StoneError):
    """Only the captain may do this."""

    code = "not_captain"

    def __init__(self, act: str) -> None:
        super().__init__(f"only the team's captain may {act}")


class NotMemberError(StoneError):
    """The team has no such member."""

    code = "not_member"

    def __init__(self, user: str) -> None:
        super().__init__(f"{user[:64]!r} is no member of this team")


class CaptainStaysError(StoneError):
    """The captain cannot leave while there are other members."""

    code = "captain_stays"

    def __init__(self) -> None:
        super().__init__(
            "the captain cannot leave while there are other members; make another member the captain first"
        )
