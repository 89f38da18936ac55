"""The audit log, quotas, replies to repeated requests, and counters of processes."""

from sqlalchemy import JSON, BigInteger, ForeignKey, Index, Integer, LargeBinary, String

from services.runtime.database.migrations.baseline.tables import ID, SHA256, indexes, key, part_of, required, table

table(
    "quota_ledger",
    key("id", ID),
    required("owner_id", ID, ForeignKey("users.id")),
    required("kind", String(16)),
    required("amount", BigInteger),
    required("subject_id", String(64)),
    required("reason", String(64)),
    required("created_ns", BigInteger),
    *indexes("subject_id"),
    Index("ix_quota_ledger_owner_amount", "owner_id", "amount"),
)

table(
    "audit_log",
    key("number", Integer),
    required("actor_id", ID),
    required("actor", String(64)),
    required("act", String(64)),
    required("subject_id", String(64)),
    required("reason", String(512)),
    required("facts", JSON),
    required("request_id", String(64)),
    required("logged_ns", BigInteger),
    required("hash", String(64), unique=True),
    *indexes("actor_id", "subject_id"),
    Index("ix_audit_log_act_number", "act", "number"),
    Index("ix_audit_log_actor_number", "actor", "number"),
)

table(
    "audit_anchors",
    key("number", Integer),
    required("hash", String(64)),
    required("cut_ns", BigInteger),
)

table(
    "idempotent_replies",
    key("id", ID),
    required("user_id", ID, part_of("users.id")),
    required("route", String(128)),
    required("key", String(128)),
    required("request_sha256", SHA256),
    required("status", Integer),
    required("headers", JSON),
    required("body", LargeBinary),
    required("created_ns", BigInteger),
    Index("uq_idempotent_replies_user_route_key", "user_id", "route", "key", unique=True),
    *indexes("created_ns"),
)

table(
    "gc_holds",
    key("id", ID),
    required("reason", String(128)),
    required("until_ns", BigInteger),
    *indexes("until_ns"),
)

table(
    "process_counters",
    key("id", ID),
    required("counts", JSON),
    required("told_ns", BigInteger),
    *indexes("told_ns"),
)

table(
    "chores",
    key("name", String(64)),
    required("done_ns", BigInteger),
)

table(
    "figures",
    key("name", String(64)),
    required("value", BigInteger),
    required("measured_ns", BigInteger),
)
