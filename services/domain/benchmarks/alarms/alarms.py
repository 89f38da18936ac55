"""Alarms for administrators: equal predictions of several teams, and probing by near-identical submissions.

**Conventions.** An alarm is about its subject: the later of two submissions, or a team's day; it is raised once, in
whatever order and however often they are scored. Withdrawn and hidden entries count; baselines where the truth is
hidden, of which probing by them would tell as much, and nowhere else.
"""

from typing import Any

from sqlalchemy import Select, select, text
from sqlalchemy.orm import Session, aliased

from services.domain.benchmarks.alarms.similarity import AlarmLimits, ScoredEntry, flat_cells, suspicions
from services.domain.benchmarks.rescores.errors import AlarmDismissedError, AlarmMissingError
from services.domain.benchmarks.submissions.scoring_quota import is_charged
from services.domain.benchmarks.visibility import ON_BOARDS
from services.runtime.database.inserts import insert_new
from services.runtime.orm import Alarm, Phase, Score, SubmissionRow, Team
from services.runtime.orm.base import new_id, now_ns

DEFAULTS = AlarmLimits()
LOCK = 0x414C524D  # "ALRM": the first half of the advisory lock's number; the second is the phase's


def raise_alarms(session: Session, score: Score, limits: AlarmLimits = DEFAULTS) -> None:
    """Raise what `score`, a row of this transaction, gives reason for; the transaction of its join, near its end.

    Two joins at once see each other: the second waits here for the first one's commit.
    """
    session.flush()
    own = session.get_one(SubmissionRow, score.submission_id)
    phase = session.get_one(Phase, own.phase_id)
    if not is_charged(phase, own.kind):
        return
    _take_turns(session, own.phase_id)
    if _is_known(session, score):
        return
    entries = _entries(score, ON_BOARDS if phase.is_hidden else ("entry",))
    mine = _scored(session, entries.where(SubmissionRow.id == own.id), 1)[0]
    found = _seen(session, entries, score, own.team_id, limits)
    others = [one for one in found if one.submission_id != own.id]
    of_team = [one for one in others if one.team_id == own.team_id]
    foreign = [one for one in others if one.team_id != own.team_id]
    raised = {"phase_id": own.phase_id, "created_ns": now_ns()}
    about = suspicions(mine, of_team, foreign, limits)
    insert_new(session, Alarm, [{"id": new_id(), **raised, **vars(one)} for one in about])


def open_alarms(phase_id: str) -> Select[Alarm]:
    """The alarms of a phase that nobody has dismissed."""
    return select(Alarm).where(Alarm.phase_id == phase_id, Alarm.dismissed_ns.is_(None))


def dismiss(session: Session, alarm_id: str) -> Alarm:
    """Somebody has looked at it; it is not raised again. Raises `AlarmMissingError`, `AlarmDismissedError`."""
    alarm = session.get(Alarm, alarm_id, with_for_update={"key_share": True}, populate_existing=True)
    if alarm is None:
        raise AlarmMissingError(alarm_id)
    if alarm.dismissed_ns is not None:
        raise AlarmDismissedError(alarm_id)
    alarm.dismissed_ns = now_ns()
    return alarm


def _take_turns(session: Session, phase_id: str) -> None:
    """Let one transaction at a time create alarms of a phase; on SQLite the transaction itself is the lock."""
    if session.get_bind().dialect.name == "postgresql":
        phase = int(phase_id[-7:], 16)
        session.execute(text("SELECT pg_advisory_xact_lock(:lock, :phase)"), {"lock": LOCK, "phase": phase})


def _is_known(session: Session, score: Score) -> bool:
    """Whether the same counts were looked at before, under another metric."""
    same = select(Score.id).where(Score.submission_id == score.submission_id, Score.truth_id == score.truth_id)
    return session.scalar(same.where(Score.id != score.id).limit(1)) is not None


def _entries(score: Score, kinds: tuple[str, ...]) -> Select[Any]:
    """Submissions of these kinds with a score against this ground truth, one row each, newest first."""
    other = aliased(Score)
    first = (
        select(other.id)
        .where(other.submission_id == SubmissionRow.id, other.truth_id == score.truth_id)
        .order_by(other.id)
        .limit(1)
        .scalar_subquery()
    )
    columns = (SubmissionRow.id, SubmissionRow.team_id, Team.name, SubmissionRow.method, SubmissionRow.finalized_ns)
    return (
        select(*columns, Score.content_sha256, Score.record["cells"])
        .join(Score, Score.submission_id == SubmissionRow.id)
        .join(Team, Team.id == SubmissionRow.team_id)
        .where(Score.id == first, SubmissionRow.kind.in_(kinds))
        .order_by(SubmissionRow.id.desc())
    )


def _seen(session: Session, entries: Select[Any], score: Score, team_id: str, limits: AlarmLimits) -> list[ScoredEntry]:
    """The last entries of the team and of others, and any others with equal content, each once."""
    foreign = SubmissionRow.team_id != team_id
    queries = (
        entries.where(SubmissionRow.team_id == team_id),
        entries.where(foreign),
        entries.where(foreign, Score.content_sha256 == score.content_sha256),
    )
    found = [one for query in queries for one in _scored(session, query, limits.looked_at)]
    return list({one.submission_id: one for one in found}.values())


def _scored(session: Session, query: Select[Any], most: int) -> list[ScoredEntry]:
    return [
        ScoredEntry(row[0], row[1], row[2], row[3], row[4] or 0, row[5], flat_cells(row[6]))
        for row in session.execute(query.limit(most))
    ]
