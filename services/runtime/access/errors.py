"""Errors of authentication and of user accounts."""

from stone.errors import Refused


def name_taken(kind: str, name: str) -> Refused:
    return Refused("name_taken", f"a {kind} named {name[:80]!r} already exists; choose another name")
