"""ORM models of notifications: what happened (the outbox), who wants to be told where, and each delivery.

**Conventions.** An event is written in the transaction of what it tells of, so neither is there without the other. A
delivery's `id` is what its receiver sees, equal in every try. A webhook's secret is kept as it is: it signs, and is no
password of anybody here.
"""

from sqlalchemy import JSON, ForeignKey, Index, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Id, Ns, Record, new_id, now_ns, partial_index

IS_UNSPREAD = "spread_ns IS NULL"
IS_DUE = "state = 'waiting'"


class NotificationEvent(Base):
    """Something that happened. It is told to `user_id`, or to the members of `team_id`, or to everybody.

    `subject_id` is the run, submission, phase or sequence it is about; `key` is unique, so that what is found twice is
    one event; `spread_ns` is when deliveries were made of it.
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
    """A user wants events of this kind by this channel (email, webhook). No row: is not told."""

    __tablename__ = "notification_choices"
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    kind: Mapped[str] = mapped_column(String(32), primary_key=True)
    channel: Mapped[str] = mapped_column(String(8), primary_key=True)


class Webhook(Base):
    """The one webhook of a user; `failing_ns` since when no try succeeded, `disabled_ns` when it was switched off."""

    __tablename__ = "webhooks"
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    url: Mapped[str] = mapped_column(String(1000))
    secret: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    failing_ns: Mapped[Ns | None]
    disabled_ns: Mapped[Ns | None]


class EmailAddress(Base):
    """The one e-mail address of a user, written to once it is verified by the link that was sent there."""

    __tablename__ = "email_addresses"
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"), primary_key=True)
    address: Mapped[str] = mapped_column(String(254))
    secret_hash: Mapped[str] = mapped_column(String(64), default="")
    expires_ns: Mapped[Ns] = mapped_column(default=0)
    verified_ns: Mapped[Ns | None]
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)


class NotificationDelivery(Base):
    """One event told to one user by one channel. `state` is queued (a job holds it), waiting (until `due_ns`),
    delivered, dropped (it may not or need not be told any more) or dead.

    `answer` is what came of the last try, in one sentence.
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
