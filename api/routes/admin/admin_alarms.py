"""Routes for administrators: alarms about submissions, and grants of extra scorings."""

from fastapi import APIRouter
from sqlalchemy import select

from api import audit
from api.answers import refusals
from api.deps import Administrator, PlatformDep
from api.errors import NotFoundError
from api.paging import Page, PageDep, page
from api.schemas.admin import AlarmItem, GrantBody, GrantItem, ReasonBody
from api.schemas.base import IdPath
from api.views.audit import grant_item
from api.visible import phase_of
from services.domain.benchmarks.alarms.alarms import dismiss, open_alarms
from services.domain.benchmarks.submissions.scoring_quota import grant, scoring_quota
from services.runtime.orm import Alarm, Team

router = APIRouter(prefix="/admin", tags=["administration"])


@router.get("/phases/{phase_id}/alarms", responses=refusals(404))
def list_alarms(
    phase_id: IdPath,
    _caller: Administrator,
    platform: PlatformDep,
    query: PageDep,
    dismissed: bool = False,
) -> Page[AlarmItem]:
    """List the open alarms of the phase, newest first; with `dismissed`, list all alarms."""
    with platform.database.reading() as session:
        of_phase = phase_of(session, phase_id).id
        seen = select(Alarm).where(Alarm.phase_id == of_phase) if dismissed else open_alarms(of_phase)
        return page(session, seen, Alarm.id.desc(), query).shown(AlarmItem.of)


@router.post("/alarms/{alarm_id}/dismiss", responses=refusals(404, 409))
def dismiss_alarm(alarm_id: IdPath, body: ReasonBody, caller: Administrator, platform: PlatformDep) -> AlarmItem:
    """Dismiss an alarm with the outcome of its review; the alarm is not raised again."""
    with platform.database.transaction() as session:
        alarm = dismiss(session, alarm_id)
        facts = {"phase_id": alarm.phase_id, "kind": alarm.kind}
        audit.record_admin_act(session, caller, "alarm.dismiss", alarm_id, body.reason, facts)
        return AlarmItem.of(alarm)


@router.post(
    "/teams/{team_id}/grants",
    summary="Grant a team more submissions, or revoke them",
    status_code=201,
    responses=refusals(404),
)
def grant_scorings(team_id: IdPath, body: GrantBody, caller: Administrator, platform: PlatformDep) -> GrantItem:
    with platform.database.transaction() as session:
        phase = phase_of(session, body.phase_id)
        if session.get(Team, team_id) is None:
            raise NotFoundError("team", team_id)
        entry = grant(session, phase, team_id, body.scorings)
        facts = {"phase_id": phase.id, "scorings": body.scorings, "entry_id": entry.id}
        audit.record_admin_act(session, caller, "team.grant", team_id, body.reason, facts)
        return grant_item(entry, scoring_quota(session, phase, team_id))
