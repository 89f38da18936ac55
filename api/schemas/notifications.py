"""Notifications over the wire: what is told, who chose what, where to, and what was delivered."""

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
    """A kind of event that one may be told of."""

    model_config = example(kind="run.failed", title="One of my runs failed")

    kind: str
    title: str


class ChoicesBody(Body):
    """The events one wants to be told of, by each channel."""

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
    """How one is told of events; `sends_email` is whether this platform can."""

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
    """What the link that was mailed ends with."""

    model_config = example(secret="x" * 43)

    secret: Annotated[str, StringConstraints(pattern="^[A-Za-z0-9_-]{20,64}$")]


class WebhookBody(Body):
    """Where to send events to: as an incoming webhook of Slack or Mattermost, or a program of one's own."""

    model_config = example(url=URL)

    url: Annotated[str, StringConstraints(pattern=PLAIN, min_length=8, max_length=1000, strip_whitespace=True)]


class DeliveryItem(Answer):
    """An event told to the caller by one channel; `answer` is what came of the last try.

    `state` is queued, waiting (until `due_at`), delivered, dropped (not to be told any more) or dead (given up).
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
