"""Notifications as response bodies: choices, places, deliveries; a webhook's secret only where it is issued."""

from sqlalchemy import select
from sqlalchemy.orm import Session

from api.paging import Page, PageQuery, page
from api.schemas.base import instant, instant_or_none
from api.schemas.notifications import (
    DeliveryItem,
    EmailItem,
    EventItem,
    IssuedWebhook,
    NotificationsItem,
    WebhookItem,
)
from services.domain.notifications.spread import choices_of
from services.runtime.notifications.events import EVENTS
from services.runtime.orm import EmailAddress, NotificationDelivery, NotificationEvent, Webhook
from services.runtime.settings import Settings


def notifications_item(session: Session, user_id: str, settings: Settings) -> NotificationsItem:
    """How the user is told of events."""
    chosen = choices_of(session, user_id)
    email, webhook = session.get(EmailAddress, user_id), session.get(Webhook, user_id)
    return NotificationsItem(
        events=[EventItem(kind=kind, title=title) for kind, title in EVENTS.items()],
        email=chosen["email"],
        webhook=chosen["webhook"],
        email_address=None if email is None else email_item(email),
        webhook_target=None if webhook is None else webhook_item(webhook),
        sends_email=bool(settings.notifications.smtp_host),
    )


def email_item(row: EmailAddress) -> EmailItem:
    return EmailItem(address=row.address, is_verified=row.verified_ns is not None)


def webhook_item(row: Webhook) -> WebhookItem:
    return WebhookItem(
        url=row.url,
        created_at=instant(row.created_ns),
        failing_since=instant_or_none(row.failing_ns),
        disabled_at=instant_or_none(row.disabled_ns),
    )


def issued_webhook(row: Webhook) -> IssuedWebhook:
    return IssuedWebhook(**webhook_item(row).model_dump(), secret=row.secret)


def deliveries_page(session: Session, query: PageQuery, user_id: str) -> Page[DeliveryItem]:
    """What the user was told, or should have been, newest first."""
    rows = page(
        session,
        select(NotificationDelivery).where(NotificationDelivery.user_id == user_id),
        NotificationDelivery.id.desc(),
        query,
    )
    ids = {row.event_id for row in rows.rows}
    found = select(NotificationEvent.id, NotificationEvent.kind).where(NotificationEvent.id.in_(ids))
    kinds = {event_id: kind for event_id, kind in session.execute(found)}
    return rows.shown(lambda row: _delivery_item(row, kinds[row.event_id]))


def _delivery_item(row: NotificationDelivery, kind: str) -> DeliveryItem:
    return DeliveryItem(
        id=row.id,
        kind=kind,
        channel=row.channel,
        state=row.state,
        tries=row.tries,
        answer=row.answer,
        created_at=instant(row.created_ns),
        due_at=instant(row.due_ns) if row.state == "waiting" else None,
        ended_at=instant_or_none(row.ended_ns),
    )
