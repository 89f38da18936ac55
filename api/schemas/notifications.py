"""Bodies of notifications: events, choices, addresses and deliveries."""

from typing import Annotated, Literal

from pydantic import AliasChoices, Field, StringConstraints

from api.schemas.base import PLAIN, Answer, Body, Instant, example

MADE = "2026-05-03T09:12:44.120000Z"
URL = "https://chat.example.org/hooks/x1"
SECRET_EXAMPLE = "whsec_" + "x" * 43 + "="

EventKind = Literal[
    "run.done",
    "run.failed",
    "labels.unusable",
    "submission.scored",
    "submission.invalid",
    "submission.failed",
    "phase.opened",
    "phase.closed",
    "quota.low",
]
Kinds = Annotated[tuple[EventKind, ...], Field(max_length=32)]


class EventItem(Answer):
    """A kind of event with notifications."""

    model_config = example(kind="run.failed", title="One of my runs failed")

    kind: str
    title: str


class ChoicesBody(Body):
    """The events to notify of, for each channel."""

    model_config = example(email=["run.failed"], webhook=["run.failed", "submission.scored"])

    email: Kinds = ()
    webhook: Kinds = ()


class EmailItem(Answer):
    """One's e-mail address; it is written to once it is verified."""

    model_config = example(address="ada@example.org", is_verified=True)

    address: str
    is_verified: bool


class WebhookItem(Answer):
    """One's webhook, without its secret; `failing_since` while it takes nothing, `disabled_at` once switched off."""

    model_config = example(url=URL)

    url: str
    created_at: Instant
    failing_since: Instant | None = Field(validation_alias=AliasChoices("failing_ns", "failing_since"))
    disabled_at: Instant | None


class IssuedWebhook(WebhookItem):
    """A webhook with the secret that signs what is sent there (Standard Webhooks), shown this once."""

    model_config = example(secret=SECRET_EXAMPLE)

    secret: str


class NotificationsItem(Answer):
    """The notification settings; `sends_email` is whether this platform sends e-mail."""

    model_config = example(email=["run.failed"], webhook=[], webhook_target=None, sends_email=True)

    events: list[EventItem]
    email: list[str]
    webhook: list[str]
    email_address: EmailItem | None
    webhook_target: WebhookItem | None
    sends_email: bool


class EmailBody(Body):
    """An address to be; a link to verify it is mailed there."""

    model_config = example(address="ada@example.org")

    address: Annotated[str, StringConstraints(pattern=PLAIN, min_length=3, max_length=254, strip_whitespace=True)]


class EmailSecretBody(Body):
    """The secret at the end of the mailed link."""

    model_config = example(secret="x" * 43)

    secret: Annotated[str, StringConstraints(pattern="^[A-Za-z0-9_-]{20,64}$")]


class WebhookBody(Body):
    """The URL for events: a Slack or Mattermost incoming webhook, or your own endpoint."""

    model_config = example(url=URL)

    url: Annotated[str, StringConstraints(pattern=PLAIN, min_length=8, max_length=1000, strip_whitespace=True)]


class DeliveryItem(Answer):
    """An event sent to the caller by one channel; `answer` is the result of the last attempt.

    `state` is queued, waiting (until `due_at`), delivered, dropped (cancelled) or dead (no attempt left).
    """

    model_config = example(
        kind="run.failed", channel="webhook", state="waiting", tries=1, answer="answered 503", due_at=MADE
    )

    id: str
    kind: str
    channel: str
    state: str
    tries: int
    answer: str
    created_at: Instant
    due_at: Instant | None
    ended_at: Instant | None
