"""Teams, drafts and their uploads in the phase of `scored.py`, made by the platform's own functions.

**Conventions.** A file is a few bytes that no stage ever reads.
"""

from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from services.runtime.benchmarks import scorings, teams
from services.runtime.benchmarks.submissions import Draft, create_draft, finalise
from services.runtime.orm import Phase, Submission, new_id
from services.runtime.platform import Platform
from tests.api.made import upload
from tests.api.serving import Person, person
from tests.services.runtime.benchmarks.scored import Place, phase_of_rows

ZIP = b"a zip of predictions"


@dataclass(frozen=True)
class Desk:
    """A participant with a team of their own, and the phase that they submit to."""

    place: Place
    captain: Person
    team_id: str

    @property
    def platform(self) -> Platform:
        return self.place.platform

    @property
    def phase_id(self) -> str:
        return self.place.phase.id


def desk_on(platform: Platform, **rules: Any) -> Desk:
    """A fresh phase with these rules, and somebody who may submit to it."""
    place = phase_of_rows(platform)
    with platform.database.transaction() as session:
        phase = session.get_one(Phase, place.phase.id)
        for name, value in rules.items():
            setattr(phase, name, value)
    return another_desk(place)


def another_desk(place: Place) -> Desk:
    """Another participant with another team in the same phase."""
    captain = person(place.platform, "participant")
    with place.platform.database.transaction() as session:
        team = teams.found(session, f"team-{new_id()[-12:]}", captain.user_id)
        return Desk(place, captain, team.id)


def announced(desk: Desk, **said: Any) -> Draft:
    """What a draft says; `said` differs from the usual."""
    usual = {"kind": "entry", "method": "Net", "description": "", "modality": "L"}
    file = {"sha256": sha256(ZIP).hexdigest(), "size_bytes": len(ZIP)}
    who = {"phase_id": desk.phase_id, "team_id": desk.team_id, "user_id": desk.captain.user_id}
    return Draft(**{**who, **usual, **file, **said})


def drafted(desk: Desk, **said: Any) -> str:
    """The id of a draft."""
    with desk.platform.database.transaction() as session:
        return create_draft(session, announced(desk, **said)).id


def uploaded(desk: Desk, submission_id: str, content: bytes = ZIP, **columns: Any) -> str:
    """The id of the complete upload for a draft."""
    said = {"purpose": "submission", "target_id": submission_id, **columns}
    return upload(desk.platform, desk.captain, content, **said)


def finalised(desk: Desk, submission_id: str = "", upload_id: str = "", **said: Any) -> str:
    """The id of a submission that is queued."""
    submission_id = submission_id or drafted(desk, **said)
    upload_id = upload_id or uploaded(desk, submission_id)
    with desk.platform.database.transaction() as session:
        finalise(session, session.get_one(Submission, submission_id), upload_id)
    return submission_id


def seen(desk: Desk, submission_id: str) -> Submission:
    """The row as it stands."""
    with desk.platform.database.reading() as session:
        return session.get_one(Submission, submission_id)


def taken(desk: Desk) -> int:
    """How many scorings the team holds."""
    with desk.platform.database.reading() as session:
        return scorings.balance(session, desk.phase_id, desk.team_id)
