"""Alarms and grants as the API shows them, and how teams stand in a phase."""

from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.schemas.alarms import AlarmItem, GrantItem
from api.schemas.base import instant, instant_or_none
from services.domain.benchmarks.submissions.scoring_quota import ScoringQuota, scoring_quota
from services.runtime.orm import Alarm, Phase, PhaseTeam, ScoringEntry, Team


@dataclass(frozen=True)
class TeamQuota:
    """A team that takes part, and what it may have scored now."""

    team_id: str
    name: str
    scoring_quota: ScoringQuota


def alarm_item(row: Alarm) -> AlarmItem:
    return AlarmItem(
        id=row.id,
        phase_id=row.phase_id,
        kind=row.kind,
        subject=row.subject,
        facts=row.facts,
        created_at=instant(row.created_ns),
        dismissed_at=instant_or_none(row.dismissed_ns),
    )


def grant_item(entry: ScoringEntry, now: ScoringQuota) -> GrantItem:
    return GrantItem(
        id=entry.id,
        phase_id=entry.phase_id,
        team_id=entry.team_id,
        scorings=-entry.amount,
        limit=now.limit,
        used=now.used,
        reserved=now.reserved,
        total_left=now.total_left,
        next_at=instant_or_none(now.next_slot_ns),
        created_at=instant(entry.created_ns),
    )


def team_quotas(session: Session, phase: Phase, limit: int) -> list[TeamQuota]:
    """The teams that take part in the phase, or were granted scorings in it, by name."""
    entered = select(PhaseTeam.team_id).where(PhaseTeam.phase_id == phase.id)
    booked = select(ScoringEntry.team_id).where(ScoringEntry.phase_id == phase.id)
    teams = select(Team).where(Team.id.in_(entered.union(booked))).order_by(Team.name).limit(limit)
    return [TeamQuota(team.id, team.name, scoring_quota(session, phase, team.id)) for team in session.scalars(teams)]
