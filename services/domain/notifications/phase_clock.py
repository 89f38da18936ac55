"""Phases that open and close: found by the clock, each moment one event.

**Conventions.** An event's key names phase and moment, so however many sweepers look, however often, there is one. A
moment that was moved, and comes, is another one. A phase without a date opens as it is made, of which nobody is told.
Moments more than `LATEST_NS` ago are told to nobody: a platform that
slept for weeks does not wake everybody up.
"""

from sqlalchemy import select

from services.runtime.notifications.events import PHASE_CLOSED, PHASE_OPENED, NewEvent, record
from services.runtime.orm import NotificationEvent, Phase
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

LATEST_NS = 2 * 86_400 * 10**9


def tell_phases(platform: Platform) -> int:
    """Record what opened and closed lately; how many moments were new."""
    now = now_ns()
    moments: list[tuple[str, str, int]] = []
    with platform.database.reading() as session:
        for kind, moment in ((PHASE_OPENED, Phase.opens_ns), (PHASE_CLOSED, Phase.closes_ns)):
            passed = select(Phase.id, moment).where(moment <= now, moment > now - LATEST_NS)
            moments += [(kind, phase_id, at_ns) for phase_id, at_ns in session.execute(passed) if at_ns is not None]
        keys = {f"{kind}:{phase_id}:{at_ns}": (kind, phase_id) for kind, phase_id, at_ns in moments}
        known = set(session.scalars(select(NotificationEvent.key).where(NotificationEvent.key.in_(keys))))
    new = [(key, *of) for key, of in keys.items() if key not in known]
    if not new:
        return 0
    with platform.database.transaction() as session:
        return sum(record(session, NewEvent(kind, phase_id, key=key)) for key, kind, phase_id in new)
