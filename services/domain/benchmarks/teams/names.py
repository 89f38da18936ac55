"""Team names: plain text, not confusable with another team's name.

**Conventions.** Two names are equal if they match after compatibility normalisation (NFKC), case folding, removal of
invisible characters and collapsing of white space. Look-alike letters of other scripts are not detected. Adding a name
takes a common advisory lock on PostgreSQL; on SQLite the transaction is the lock.
"""

import re
import unicodedata

from sqlalchemy import select, text
from sqlalchemy.orm import Session

from services.runtime.access.errors import name_taken
from services.runtime.orm import Team
from stone.errors import Refused

LOCK = 0x5445414D  # "TEAM": key of the advisory lock shared by all processes of the platform
LONGEST = 64
# Default_Ignorable_Code_Point (Unicode 15): fillers, joiners, variation selectors, tags.
UNSEEN = re.compile(
    "[\u00ad\u034f\u061c\u115f\u1160\u17b4\u17b5\u180b-\u180f\u200b-\u200f\u202a-\u202e\u2060-\u206f\u3164"
    "\ufe00-\ufe0f\ufeff\uffa0\ufff0-\ufff8\U0001bca0-\U0001bca3\U0001d173-\U0001d17a\U000e0000-\U000e0fff]"
)


def reserve_name(session: Session, name: str) -> str:
    """Return the name in its stored form (NFC), reserved until the end of the transaction.

    Raises `bad_team_name`, `name_taken`.
    """
    kept, wanted = unicodedata.normalize("NFC", name), folded(name)
    if not wanted or len(kept) > LONGEST:
        raise Refused(
            "bad_team_name",
            f"the name has {len(kept)} composed and {len(wanted)} visible characters; expected 1 to {LONGEST} of each "
            "kind",
        )
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": LOCK})
    if any(folded(other) == wanted for other in session.scalars(select(Team.name))):
        raise name_taken("team", name)
    return kept


def folded(name: str) -> str:
    """Return a form of the name that is equal for confusable names."""
    once = unicodedata.normalize("NFKC", UNSEEN.sub("", name)).casefold()
    return " ".join(unicodedata.normalize("NFKC", UNSEEN.sub("", once)).split())
