"""Teams, drafts and their uploads in the phase of `scored.py`, made by the platform's own functions.

**Conventions.** A file is a few bytes that no stage ever reads.
"""

from dataclasses import dataclass
from hashlib import sha256
from typing import Any

from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions import scoring_quota
from services.domain.benchmarks.submissions.scoring_quota import ScoringQuota
from services.domain.benchmarks.submissions.submissions import SubmissionDraft, create_draft, finalise
from services.domain.benchmarks.teams import teams
from services.runtime.orm import Phase, SubmissionRow, new_id
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from testing.worlds.made import upload
from tests.services.domain.benchmarks.scored import Place, phase_of_rows

ZIP = b"a zip of predictions"


@dataclass(frozen=True)
class Entrant:
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


def entrant_on(platform: Platform, **rules: Any) -> Entrant:
    """A fresh phase with these rules, and somebody who may submit to it."""
    place = phase_of_rows(platform)
    with platform.database.transaction() as session:
        phase = session.get_one(Phase, place.phase.id)
        for name, value in rules.items():
            setattr(phase, name, value)
    return another_entrant(place)


def another_entrant(place: Place) -> Entrant:
    """Another participant with another team in the same phase."""
    captain = person(place.platform, "participant")
    with place.platform.database.transaction() as session:
        team = teams.create_team(session, f"team-{new_id()[-12:]}", captain.user_id)
        return Entrant(place, captain, team.id)


def announced(entrant: Entrant, **said: Any) -> SubmissionDraft:
    """What a draft says; `said` differs from the usual."""
    usual = {"kind": "entry", "method": "Net", "description": "", "modality": "L"}
    file = {"sha256": sha256(ZIP).hexdigest(), "size_bytes": len(ZIP)}
    who = {"phase_id": entrant.phase_id, "team_id": entrant.team_id, "user_id": entrant.captain.user_id}
    return SubmissionDraft(**{**who, **usual, **file, **said})


def drafted(entrant: Entrant, **said: Any) -> str:
    """The id of a draft."""
    with entrant.platform.database.transaction() as session:
        return create_draft(session, announced(entrant, **said)).id


def uploaded(entrant: Entrant, submission_id: str, content: bytes = ZIP, **columns: Any) -> str:
    """The id of the complete upload for a draft."""
    said = {"purpose": "submission", "target_id": submission_id, **columns}
    return upload(entrant.platform, entrant.captain, content, **said)


def finalised(entrant: Entrant, submission_id: str = "", upload_id: str = "", **said: Any) -> str:
    """The id of a submission that is queued."""
    submission_id = submission_id or drafted(entrant, **said)
    upload_id = upload_id or uploaded(entrant, submission_id)
    with entrant.platform.database.transaction() as session:
        finalise(session, session.get_one(SubmissionRow, submission_id), upload_id)
    return submission_id


def seen(entrant: Entrant, submission_id: str) -> SubmissionRow:
    """The row as it stands."""
    with entrant.platform.database.reading() as session:
        return session.get_one(SubmissionRow, submission_id)


def taken(entrant: Entrant) -> int:
    """How many scorings the team holds."""
    with entrant.platform.database.reading() as session:
        return scoring_quota.balance(session, entrant.phase_id, entrant.team_id)


def reserved(entrant: Entrant) -> str:
    """The id of a draft for which a scoring is taken."""
    submission_id = drafted(entrant)
    with entrant.platform.database.transaction() as session:
        scoring_quota.reserve(session, session.get_one(Phase, entrant.phase_id), entrant.team_id, submission_id)
    return submission_id


def standing(entrant: Entrant, at_ns: int | None = None) -> ScoringQuota:
    with entrant.platform.database.reading() as session:
        return scoring_quota.scoring_quota(session, session.get_one(Phase, entrant.phase_id), entrant.team_id, at_ns)


def another_phase(session: Session, entrant: Entrant, per_window: int | None = None, total: int | None = None) -> Phase:
    phase = Phase(benchmark_id=entrant.place.phase.benchmark_id, name=new_id(), part="val", is_hidden=False)
    phase.scorings_per_window, phase.scorings_total, phase.dataset_id = per_window, total, entrant.place.dataset_id
    session.add(phase)
    session.flush()
    return phase


def a_submission(session: Session, phase: Phase, entrant: Entrant) -> str:
    row = SubmissionRow(phase_id=phase.id, team_id=entrant.team_id, user_id=entrant.captain.user_id, method="Net")
    row.modality, row.declared_sha256, row.size_bytes = "L", "0" * 64, 1
    session.add(row)
    session.flush()
    return row.id
