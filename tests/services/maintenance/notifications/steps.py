"""What the tests of notifications share: a platform that may send to this machine, users, the sweeper's turn."""

from dataclasses import replace
from typing import Any

from services.domain.notifications.spread import choose, queue_due, record_phase_events, retry_lost, spread_events
from services.domain.notifications.webhooks import set_webhook
from services.maintenance.notifications.delivery import deliver_queued
from services.runtime.notification_settings import NotificationSettings
from services.runtime.notifications.events import EVENTS, QUOTA_LOW, NewEvent, record
from services.runtime.orm import EmailAddress, NotificationDelivery, User
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

LOCAL: dict[str, Any] = {"allows_http": True, "webhook_networks": "127.0.0.0/8 ::1"}


def telling(platform: Platform, **settings: Any) -> Platform:
    """The platform, which may send to this machine by http."""
    told = NotificationSettings(**{**LOCAL, **settings})
    return replace(platform, settings=platform.settings.model_copy(update={"notifications": told}))


def a_user(platform: Platform, name: str, url: str = "", email: str = "") -> str:
    """A user who wants to be told of everything at these places."""
    with platform.database.transaction() as session:
        user = User(name=name, role="curator")
        session.add(user)
        session.flush()
        choose(session, user.id, {"webhook": list(EVENTS) if url else [], "email": list(EVENTS) if email else []})
        if url:
            set_webhook(session, user.id, url, platform.settings.notifications)
        if email:
            session.add(EmailAddress(user_id=user.id, address=email, verified_ns=now_ns()))
        return user.id


def happened(platform: Platform, user_id: str, **facts: Any) -> None:
    """An event of the user: their storage is nearly full."""
    told = {"what": "storage", "used_bytes": 9 << 30, "limit_bytes": 10 << 30, **facts}
    with platform.database.transaction() as session:
        record(session, NewEvent(QUOTA_LOW, "", user_id=user_id, facts=told))


def turn(platform: Platform) -> int:
    """What the sweeper does in one turn; how much there was to do."""
    before = record_phase_events(platform) + spread_events(platform) + queue_due(platform) + retry_lost(platform)
    return before + deliver_queued(platform)


def all_sent(platform: Platform) -> None:
    """Turns until there is nothing to do."""
    while turn(platform):
        pass


def deliveries(platform: Platform) -> list[NotificationDelivery]:
    with platform.database.reading() as session:
        return session.query(NotificationDelivery).order_by(NotificationDelivery.id).all()
