"""Notification events, users' choices and addresses, deliveries."""

from sqlalchemy import JSON, BigInteger, ForeignKey, Index, Integer, String

from services.runtime.database.migrations.baseline.tables import (
    ID,
    indexes,
    key,
    optional,
    part_of,
    partial_index,
    required,
    table,
)

table(
    "notification_events",
    key("id", ID),
    required("kind", String(32)),
    required("key", String(128), unique=True),
    optional("user_id", ID, part_of("users.id")),
    optional("team_id", ID, part_of("teams.id")),
    required("subject_id", ID),
    required("facts", JSON),
    required("created_ns", BigInteger),
    optional("spread_ns", BigInteger),
    *indexes("created_ns"),
    partial_index("ix_notification_events_unspread", "spread_ns IS NULL", "id"),
)

table(
    "notification_choices",
    key("user_id", ID, part_of("users.id")),
    key("kind", String(32)),
    key("channel", String(8)),
)

table(
    "webhooks",
    key("user_id", ID, part_of("users.id")),
    required("url", String(1000)),
    required("secret", String(64)),
    required("created_ns", BigInteger),
    optional("failing_ns", BigInteger),
    optional("disabled_ns", BigInteger),
)

table(
    "email_addresses",
    key("user_id", ID, part_of("users.id")),
    required("address", String(254)),
    required("secret_hash", String(64)),
    required("expires_ns", BigInteger),
    optional("verified_ns", BigInteger),
    required("created_ns", BigInteger),
)

table(
    "notification_deliveries",
    key("id", ID),
    required("event_id", ID, part_of("notification_events.id")),
    required("user_id", ID, part_of("users.id")),
    required("channel", String(8)),
    required("state", String(16)),
    required("tries", Integer),
    required("answer", String(300)),
    optional("job_id", ID, ForeignKey("jobs.id", ondelete="SET NULL")),
    required("due_ns", BigInteger),
    required("created_ns", BigInteger),
    optional("ended_ns", BigInteger),
    *indexes("job_id"),
    Index("ix_notification_deliveries_state", "state", "due_ns"),
    Index("ix_notification_deliveries_user_id", "user_id", "id"),
    Index("uq_notification_deliveries_event_user_channel", "event_id", "user_id", "channel", unique=True),
)
