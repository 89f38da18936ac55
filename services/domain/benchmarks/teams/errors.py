"""Errors of founding, joining, leaving and leading teams."""

from stone.errors import Refused


def already_in_team(phase: str) -> Refused:
    return Refused(
        "already_in_team",
        f"somebody of this team takes part in phase {phase!r} with another team; "
        "only one team per person and phase is allowed",
    )
