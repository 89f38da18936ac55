"""Names of teams: plain text, and none that passes for another.

**Conventions.** Two names are one when they are equal after compatibility normalisation (NFKC), case folding and with
every run of white space as one space. On PostgreSQL whoever adds a name holds a lock that all who do so take; on SQLite
the transaction is that lock.
"""

import unicodedata

from sqlalchemy import select, text
from sqlalchemy.orm import Session

from services.runtime.access.errors import NameTakenError
from services.runtime.orm import Team

LOCK = 0x5445414D  # "TEAM": the advisory lock's number, shared by every process of the platform


def refuse_taken(session: Session, name: str) -> None:
    """Hold the names until the transaction ends. Raises `NameTakenError`."""
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": LOCK})
    wanted = folded(name)
    if any(folded(other) == wanted for other in session.scalars(select(Team.name))):
        raise NameTakenError("team", name)


def folded(name: str) -> str:
    """What two names that look alike have in common."""
    once = unicodedata.normalize("NFKC", name).casefold()
    return " ".join(unicodedata.normalize("NFKC", once).split())


def shown(name: str) -> str:
    """The name as it is kept: composed (NFC)."""
    return unicodedata.normalize("NFC", name)
