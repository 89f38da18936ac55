"""The scoring quota of teams: an append-only ledger whose sum is the balance.

**Conventions.** Finalising a submission reserves a scoring (+1). Its score consumes the scoring (0), any other end
releases it (−1), and retrying its run retakes it (+1). A submission's balance counts from the last time it was taken.
If the ground truth is hidden, releases after counting started are bounded per window. Entries cost one scoring;
baselines too if the ground truth is hidden, since every score reveals something of it. A grant (negative, without a
submission) raises the total permanently and the window's limit for one window. Each function is part of the caller's
transaction; taking a scoring locks the team's row, so two transactions cannot both take the last scoring. Locks are
taken in one order: run, submission, upload, team.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from sqlalchemy import ColumnElement, Row, case, func, select
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions.errors import scorings_exhausted
from services.domain.benchmarks.teams.teams import lock_team
from services.runtime.notifications.events import QUOTA_LOW, NewEvent, record
from services.runtime.orm import Phase, ScoringEntry
from services.runtime.orm.base import now_ns

RESERVED, CONSUMED, GRANTED = "reserved", "consumed", "granted"
COUNTED = "released after counting"
GIVEN_BACK = 10
"""Most scorings per window that are returned to a team after counting started, if the ground truth is hidden. A
submission that takes over its counting child can choose its end according to the ground truth.
"""
FEW_OF = 5
"""Few scorings are left if at most a fifth of the limit remains, rounded down."""


@dataclass(frozen=True)
class ScoringQuota:
    """A team's scoring quota in a phase; null limits mean unlimited scorings.

    - `limit`: scorings per window, grants included; `used`: scored; `reserved`: in progress
    - `next_slot_ns`: when the next submission may be finalised: now, later, or null for never
    - `window_ns`: length of the window
    """

    limit: int | None
    used: int
    reserved: int
    total_left: int | None
    next_slot_ns: int | None
    window_ns: int


def is_charged(phase: Phase, kind: str) -> bool:
    """Return whether a submission of this kind costs a scoring."""
    return kind == "entry" or (kind == "baseline" and phase.is_hidden)


def reserve(session: Session, phase: Phase, team_id: str, submission_id: str) -> None:
    """Reserve a scoring for the submission. Raises `scorings_exhausted`, and then reserves nothing."""
    lock_team(session, team_id)
    now = scoring_quota(session, phase, team_id)
    if now.total_left is not None and now.total_left <= 0:
        total = phase.scorings_total or 0
        raise scorings_exhausted(total, total, None, None)
    if now.limit is not None and now.used + now.reserved >= now.limit:
        raise scorings_exhausted(now.used + now.reserved, now.limit, phase.window_ns, now.next_slot_ns)
    _add(session, ScoringEntry(phase_id=phase.id, team_id=team_id, submission_id=submission_id), 1, RESERVED)
    _record_low_quota(session, now, phase, team_id)


def consume(session: Session, submission_id: str) -> None:
    """Record that the submission used its reserved scoring."""
    for phase_id, team_id in _charged_to(session, submission_id):
        entry = ScoringEntry(phase_id=phase_id, team_id=team_id, submission_id=submission_id)
        _add(session, entry, 0, CONSUMED)


def release(session: Session, submission_id: str, reason: str) -> int:
    """Release the submission's scoring; return the number of released scorings, 0 if already released."""
    return _settle_at(session, submission_id, 0, reason)


def release_counted(session: Session, submission_id: str, state: str) -> int:
    """Release the scoring like `release`, after counting started; after `GIVEN_BACK` such releases it stays used."""
    for phase_id, team_id in _charged_to(session, submission_id):
        lock_team(session, team_id)
        phase = session.get_one(Phase, phase_id)
        if phase.is_hidden and _given_back_in_window(session, phase, team_id) >= GIVEN_BACK:
            consume(session, submission_id)
            return 0
    return release(session, submission_id, f"{COUNTED}: {state}")


def retake(session: Session, submission_id: str) -> int:
    """Retake a released scoring regardless of the limit, because an administrator retries the run."""
    return -_settle_at(session, submission_id, 1, RESERVED)


def grant(session: Session, phase: Phase, team_id: str, amount: int, reason: str = GRANTED) -> ScoringEntry:
    """Allow a team `amount` more scorings (negative: revoke a grant). `reason` is at most 64 characters."""
    lock_team(session, team_id)
    return _add(session, ScoringEntry(phase_id=phase.id, team_id=team_id), -amount, reason[:64])


def scoring_quota(session: Session, phase: Phase, team_id: str, at_ns: int | None = None) -> ScoringQuota:
    """Return the team's remaining scorings, and when the next one is available."""
    at_ns = now_ns() if at_ns is None else at_ns
    taken = _taken_in_window(session, phase, team_id, at_ns)
    granted = _granted_in_window(session, phase, team_id, at_ns)
    used = sum(row.amount for row in taken if row.is_consumed)
    reserved = sum(row.amount for row in taken if not row.is_consumed)
    total_left = None if phase.scorings_total is None else phase.scorings_total - balance(session, phase.id, team_id)
    limit = phase.scorings_per_window
    next_ns: int | None = at_ns
    if total_left is not None and total_left <= 0:
        total_left, next_ns = 0, None
    elif limit is not None:
        steps = [(row.taken_ns, -row.amount) for row in taken] + [(row.taken_ns, -row.amount) for row in granted]
        surplus = used + reserved + sum(row.amount for row in granted) - limit
        next_ns = _first_free_ns(surplus, [(since + phase.window_ns, step) for since, step in steps], at_ns)
    shown = None if limit is None else max(0, limit - sum(row.amount for row in granted))
    return ScoringQuota(shown, used, reserved, total_left, next_ns, phase.window_ns)


def balance(session: Session, phase_id: str, team_id: str) -> int:
    """Return the sum of all entries: used and reserved scorings, less grants."""
    total = select(func.coalesce(func.sum(ScoringEntry.amount), 0)).where(*_of_team(phase_id, team_id))
    return int(session.scalar(total) or 0)


def _record_low_quota(session: Session, before: ScoringQuota, phase: Phase, team_id: str) -> None:
    """Record an event if the scoring just taken leaves only few in the window or in total."""
    in_window = None if before.limit is None else before.limit - before.used - before.reserved
    for left, limit in ((in_window, before.limit), (before.total_left, phase.scorings_total)):
        if left is not None and left - 1 <= (limit or 0) // FEW_OF < left:
            facts = {"what": "scorings", "left": left - 1}
            record(session, NewEvent(QUOTA_LOW, phase.id, team_id=team_id, facts=facts))
            return


def _first_free_ns(surplus: int, steps: Sequence[tuple[int, int]], at_ns: int) -> int | None:
    """Return when the surplus over the limit first falls below zero, as scorings and grants leave the window."""
    if surplus < 0:
        return at_ns
    for moment in sorted({moment for moment, _ in steps}):
        surplus += sum(step for when, step in steps if when == moment)
        if surplus < 0:
            return moment
    return None


def _taken_in_window(session: Session, phase: Phase, team_id: str, at_ns: int) -> Sequence[Row[int, int, int]]:
    """Return the time taken, amount and consumption of each submission that holds a scoring taken in the window.

    All entries of a submission count, regardless of their time: a submission that was reserved before the window, then
    released and retaken within it, holds a scoring.
    """
    is_consumed = func.max(case((ScoringEntry.reason == CONSUMED, 1), else_=0)).label("is_consumed")
    amount = func.sum(ScoringEntry.amount).label("amount")
    since = func.max(case((ScoringEntry.amount > 0, ScoringEntry.created_ns))).label("taken_ns")
    held = select(since, amount, is_consumed).where(*_of_team(phase.id, team_id))
    held = held.where(ScoringEntry.submission_id.is_not(None)).group_by(ScoringEntry.submission_id)
    return session.execute(held.having(func.sum(ScoringEntry.amount) > 0, since > at_ns - phase.window_ns)).all()


def _granted_in_window(session: Session, phase: Phase, team_id: str, at_ns: int) -> Sequence[Row[int, int]]:
    """Return the grants of the window as negative amounts."""
    granted = select(ScoringEntry.created_ns.label("taken_ns"), ScoringEntry.amount.label("amount"))
    granted = granted.where(*_of_team(phase.id, team_id), ScoringEntry.submission_id.is_(None))
    return session.execute(granted.where(ScoringEntry.created_ns > at_ns - phase.window_ns)).all()


def _given_back_in_window(session: Session, phase: Phase, team_id: str) -> int:
    """Return the number of the team's scorings released in this window after counting started."""
    given_back = select(func.count()).select_from(ScoringEntry).where(*_of_team(phase.id, team_id))
    after_counting = (ScoringEntry.amount < 0, ScoringEntry.reason.startswith(COUNTED))
    return session.scalar(given_back.where(*after_counting, ScoringEntry.created_ns > now_ns() - phase.window_ns)) or 0


def _of_team(phase_id: str, team_id: str) -> tuple[ColumnElement[bool], ...]:
    return ScoringEntry.phase_id == phase_id, ScoringEntry.team_id == team_id


def _settle_at(session: Session, submission_id: str, wanted: int, reason: str) -> int:
    """Set the scorings that the submission holds to `wanted`, if it ever held any; return the number released.

    The balance is read under the team's lock, so concurrent calls settle it once.
    """
    given_back = 0
    for phase_id, team_id in _charged_to(session, submission_id):
        lock_team(session, team_id)
        taken = _held_scorings(session, submission_id)
        if taken == wanted:
            continue
        entry = ScoringEntry(phase_id=phase_id, team_id=team_id, submission_id=submission_id)
        _add(session, entry, wanted - taken, reason[:64])
        given_back += taken - wanted
    return given_back


def _charged_to(session: Session, submission_id: str) -> Sequence[Row[str, str]]:
    """Return the (phase, team) that was ever charged for the submission: one row, or none."""
    charged = select(ScoringEntry.phase_id, ScoringEntry.team_id).where(ScoringEntry.submission_id == submission_id)
    return session.execute(charged.distinct()).all()


def _held_scorings(session: Session, submission_id: str) -> int:
    held = select(func.sum(ScoringEntry.amount)).where(ScoringEntry.submission_id == submission_id)
    return int(session.scalar(held) or 0)


def _add(session: Session, entry: ScoringEntry, amount: int, reason: str) -> ScoringEntry:
    entry.amount, entry.reason, entry.created_ns = amount, reason, now_ns()
    session.add(entry)
    session.flush()
    return entry
