"""Notifications as response bodies: choices, addresses, deliveries; a webhook's secret only when it is issued."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.paging import Page, PageQuery, page
from api.schemas.notifications import (
    DeliveryItem,
    EmailItem,
    EventItem,
    NotificationsItem,
    WebhookItem,
)
from services.domain.notifications.spread import choices_of
from services.runtime.notifications.events import EVENTS
from services.runtime.orm import EmailAddress, NotificationDelivery, NotificationEvent, Webhook
from services.runtime.settings import Settings


def notifications_item(session: Session, user_id: str, settings: Settings) -> NotificationsItem:
    """Return the user's notification settings."""
    chosen = choices_of(session, user_id)
    email, webhook = session.get(EmailAddress, user_id), session.get(Webhook, user_id)
    return NotificationsItem(
        events=[EventItem(kind=kind, title=title) for kind, title in EVENTS.items()],
        email=chosen["email"],
        webhook=chosen["webhook"],
        email_address=None if email is None else email_item(email),
        webhook_target=None if webhook is None else WebhookItem.of(webhook),
        sends_email=bool(settings.notifications.smtp_host),
    )


def email_item(row: EmailAddress) -> EmailItem:
    return EmailItem.of(row, is_verified=row.verified_ns is not None)


def deliveries_page(session: Session, query: PageQuery, user_id: str) -> Page[DeliveryItem]:
    """Return the user's deliveries in any state, newest first."""
    rows = page(
        session,
        select(NotificationDelivery).where(NotificationDelivery.user_id == user_id),
        NotificationDelivery.id.desc(),
        query,
    )
    ids = {row.event_id for row in rows.rows}
    events = select(NotificationEvent.id, NotificationEvent.kind).where(NotificationEvent.id.in_(ids))
    kinds = {event_id: kind for event_id, kind in session.execute(events)}
    return rows.shown(
        lambda row: DeliveryItem.of(
            row, kind=kinds[row.event_id], due_at=row.due_ns if row.state == "waiting" else None
        )
    )
