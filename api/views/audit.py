"""Audit log lines and the check of their hash chain, as response bodies."""

from dataclasses import dataclass

from sqlalchemy import func, select
from sqlalchemy.orm import Session, aliased

from api.paging import Page, PageQuery, page
from api.schemas.admin import GrantItem
from api.schemas.audit import AuditLine
from services.domain.benchmarks.submissions.scoring_quota import ScoringQuota, scoring_quota
from services.runtime.orm import AuditEntry, Phase, PhaseTeam, ScoringEntry, Team


@dataclass(frozen=True)
class AuditFilter:
    """A filter of audit lines; a line must match every given value."""

    act: str | None = None
    actor: str | None = None
    actor_id: str | None = None
    subject_id: str | None = None


def audit_page(session: Session, query: PageQuery, wanted: AuditFilter) -> Page[AuditLine]:
    """Return the lines that match, newest first."""
    entries = select(AuditEntry).filter_by(**{name: value for name, value in vars(wanted).items() if value})
    return page(session, entries, AuditEntry.number.desc(), query).shown(AuditLine.of)


def acts_known(session: Session) -> list[str]:
    """Return the acts in the log, by name; each step looks up the next one in the index."""
    later = aliased(AuditEntry)
    acts = select(func.min(AuditEntry.act).label("act")).cte(recursive=True)
    after = select(func.min(later.act)).where(later.act > acts.c.act).correlate(acts).scalar_subquery()
    acts = acts.union_all(select(after).where(acts.c.act.is_not(None)))
    return list(session.scalars(select(acts.c.act).where(acts.c.act.is_not(None)).order_by(acts.c.act)))


@dataclass(frozen=True)
class TeamQuota:
    """A team that takes part, and what it may have scored now."""

    team_id: str
    name: str
    scoring_quota: ScoringQuota


def grant_item(entry: ScoringEntry, now: ScoringQuota) -> GrantItem:
    return GrantItem.of(
        now,
        id=entry.id,
        phase_id=entry.phase_id,
        team_id=entry.team_id,
        scorings=-entry.amount,
        next_at=now.next_slot_ns,
        created_at=entry.created_ns,
    )


def team_quotas(session: Session, phase: Phase, limit: int) -> list[TeamQuota]:
    """Return the teams that take part in the phase, or were granted scorings in it, by name."""
    entered = select(PhaseTeam.team_id).where(PhaseTeam.phase_id == phase.id)
    booked = select(ScoringEntry.team_id).where(ScoringEntry.phase_id == phase.id)
    teams = select(Team).where(Team.id.in_(entered.union(booked))).order_by(Team.name).limit(limit)
    return [TeamQuota(team.id, team.name, scoring_quota(session, phase, team.id)) for team in session.scalars(teams)]
