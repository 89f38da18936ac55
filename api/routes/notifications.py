"""Routes of notifications: their events, e-mail address and webhook.

**Conventions.** All notifications are off by default. Choosing events requires the scope `submit`, which every role
has. Changing an address requires the scope `account`, as for a credential, because it decides who receives the events.
Only the response that creates a webhook's secret contains it.
"""

from fastapi import APIRouter, Response

from api import audit
from api.answers import refusals
from api.deps import AccountHolder, PlatformDep, Reader, Submitter
from api.paging import Page, PageDep
from api.schemas.notifications import (
    ChoicesBody,
    DeliveryItem,
    EmailBody,
    EmailItem,
    EmailSecretBody,
    IssuedWebhook,
    NotificationsItem,
    WebhookBody,
)
from api.views.notifications import deliveries_page, email_item, notifications_item
from services.domain.notifications import email_addresses, webhooks
from services.domain.notifications.spread import choose
from services.runtime.orm import Webhook

router = APIRouter(prefix="/notifications", tags=["people"])


@router.get("", summary="Show the notification settings")
def show_notifications(caller: Reader, platform: PlatformDep) -> NotificationsItem:
    with platform.database.reading() as session:
        return notifications_item(session, caller.user_id, platform.settings)


@router.put("/choices", summary="Choose the events to be notified of")
def choose_events(body: ChoicesBody, caller: Submitter, platform: PlatformDep) -> NotificationsItem:
    """Replace the earlier choice; an empty choice disables all notifications."""
    choices = body.model_dump()
    with platform.database.transaction() as session:
        choose(session, caller.user_id, choices)
        audit.record(session, caller, "notifications.choose", caller.user_id, facts=choices)
        return notifications_item(session, caller.user_id, platform.settings)


@router.put("/email", status_code=202, summary="Set your e-mail address", responses=refusals(409))
def set_email(body: EmailBody, caller: AccountHolder, platform: PlatformDep) -> EmailItem:
    """Set the address and mail a link to verify it, at most five a day. Other mails start once the link is used."""
    with platform.database.transaction() as session:
        row = email_addresses.set_address(session, caller.user_id, body.address, platform.settings.notifications)
        audit.record(session, caller, "notifications.email", caller.user_id)
        return email_item(row)


@router.post("/email/verification", summary="Verify your e-mail address", responses=refusals(409))
def verify_email(body: EmailSecretBody, caller: AccountHolder, platform: PlatformDep) -> EmailItem:
    """Verify the address with the secret of the mailed link."""
    with platform.database.transaction() as session:
        row = email_addresses.verify(session, caller.user_id, body.secret)
        audit.record(session, caller, "notifications.email_verified", caller.user_id)
        return email_item(row)


@router.delete("/email", status_code=204, summary="Remove your e-mail address")
def remove_email(caller: AccountHolder, platform: PlatformDep) -> None:
    with platform.database.transaction() as session:
        email_addresses.remove_address(session, caller.user_id)
        audit.record(session, caller, "notifications.email_removed", caller.user_id)


@router.put("/webhook", summary="Set your webhook")
def set_webhook(body: WebhookBody, caller: AccountHolder, response: Response, platform: PlatformDep) -> IssuedWebhook:
    """Set the webhook. The response contains a new secret and is not stored. The secret signs all deliveries (Standard
    Webhooks 1.0).
    """
    with platform.database.transaction() as session:
        row = webhooks.set_webhook(session, caller.user_id, body.url, platform.settings.notifications)
        audit.record(session, caller, "notifications.webhook", caller.user_id)
    return _issued(row, response)


@router.post("/webhook/secret", summary="Replace the secret of your webhook", responses=refusals(404))
def rotate_webhook_secret(caller: AccountHolder, response: Response, platform: PlatformDep) -> IssuedWebhook:
    """Replace the secret; the old one becomes invalid. A webhook that was switched off is switched on again."""
    with platform.database.transaction() as session:
        row = webhooks.rotate_secret(session, caller.user_id)
        audit.record(session, caller, "notifications.webhook_secret", caller.user_id)
    return _issued(row, response)


@router.delete("/webhook", status_code=204, summary="Remove your webhook")
def remove_webhook(caller: AccountHolder, platform: PlatformDep) -> None:
    with platform.database.transaction() as session:
        webhooks.remove_webhook(session, caller.user_id)
        audit.record(session, caller, "notifications.webhook_removed", caller.user_id)


@router.get("/deliveries", summary="List the deliveries, newest first")
def list_deliveries(caller: Reader, query: PageDep, platform: PlatformDep) -> Page[DeliveryItem]:
    """Return each delivery with the result of its last attempt. Deliveries are kept for a month."""
    with platform.database.reading() as session:
        return deliveries_page(session, query, caller.user_id)


def _issued(row: Webhook, response: Response) -> IssuedWebhook:
    response.headers["Cache-Control"] = "no-store"
    return IssuedWebhook.of(row)
