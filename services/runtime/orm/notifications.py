"""ORM models of notifications: events (the outbox), users' choices and addresses, and each delivery.

**Conventions.** An event is written in the transaction of its cause, so neither exists without the other. A receiver
sees a delivery's `id`, equal in every attempt. A webhook's secret is stored in plain text: it signs messages, and is
not a user's password.
"""

from sqlalchemy import JSON, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Id, Ns, Record, new_id, now_ns, partial_index

IS_UNSPREAD = "spread_ns IS NULL"
IS_DUE = "state = 'waiting'"


class NotificationEvent(Base):
    """An event for `user_id`, or for the members of `team_id`, or for all users.

    `subject_id` is its run, submission, phase or sequence. `key` is unique, so an event detected twice is stored once.
    `spread_ns` is the time when its deliveries were created.
    """

    __tablename__ = "notification_events"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    kind: Mapped[str] = mapped_column(String(32))
    key: Mapped[str] = mapped_column(String(128), unique=True)
    user_id: Mapped[Id | None] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"))
    team_id: Mapped[Id | None] = mapped_column(ForeignKey("teams.id", ondelete="CASCADE"))
    subject_id: Mapped[str] = mapped_column(String(32), default="")
    facts: Mapped[Record] = mapped_column(JSON, default=dict)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns, index=True)
    spread_ns: Mapped[Ns | None]

    __table_args__ = (partial_index("ix_notification_events_unspread", IS_UNSPREAD, "id"),)


class NotificationChoice(Base):
    """A user wants events of this kind by this channel (email, webhook); without a row, no delivery."""

    __tablename__ = "notification_choices"
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    kind: Mapped[str] = mapped_column(String(32), primary_key=True)
    channel: Mapped[str] = mapped_column(String(8), primary_key=True)


class Webhook(Base):
    """The webhook of a user; `failing_ns`: failing since, null after a success; `disabled_ns`: switched off."""

    __tablename__ = "webhooks"
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    url: Mapped[str] = mapped_column(String(1000))
    secret: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    failing_ns: Mapped[Ns | None]
    disabled_ns: Mapped[Ns | None]


class EmailAddress(Base):
    """The e-mail address of a user, used once the user has followed the verification link."""

    __tablename__ = "email_addresses"
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    address: Mapped[str] = mapped_column(String(254))
    secret_hash: Mapped[str] = mapped_column(String(64), default="")
    expires_ns: Mapped[Ns] = mapped_column(default=0)
    verified_ns: Mapped[Ns | None]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class NotificationDelivery(Base):
    """One event for one user by one channel. `state`: queued (a job has it), waiting, delivered, dropped, dead.

    It waits until `due_ns`. A dropped delivery is not allowed or not needed any more. `answer` describes the last
    attempt in one sentence.
    """

    __tablename__ = "notification_deliveries"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    event_id: Mapped[Id] = mapped_column(ForeignKey("notification_events.id", ondelete="CASCADE"))
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"))
    channel: Mapped[str] = mapped_column(String(8))
    state: Mapped[str] = mapped_column(String(16), default="queued")
    tries: Mapped[int] = mapped_column(default=0)
    answer: Mapped[str] = mapped_column(String(300), default="")
    job_id: Mapped[Id | None] = mapped_column(ForeignKey("jobs.id", ondelete="SET NULL"), index=True)
    due_ns: Mapped[Ns] = mapped_column(default=0)
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    ended_ns: Mapped[Ns | None]

    __table_args__ = (
        Index("uq_notification_deliveries_event_user_channel", "event_id", "user_id", "channel", unique=True),
        Index("ix_notification_deliveries_user_id", "user_id", "id"),
        Index("ix_notification_deliveries_state", "state", "due_ns"),
    )
