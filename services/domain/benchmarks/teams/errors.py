"""Errors of creating, joining, leaving and leading teams."""

from stone.errors import Refused


def already_in_team(phase: str) -> Refused:
    return Refused(
        "already_in_team",
        f"a member of this team takes part in phase {phase!r} with another team; each person can take part in a phase "
        "with one team only",
    )
