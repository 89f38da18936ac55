"""Jobs, their attempts and lines, queues, workers."""

from sqlalchemy import JSON, BigInteger, Double, ForeignKey, Index, Integer, String, text

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

IS_READY = "state = 'queued' AND needs_left = 0"

table(
    "jobs",
    key("id", ID),
    required("root_id", ID, part_of("jobs.id")),
    required("owner_id", ID, ForeignKey("users.id")),
    optional("sequence_id", ID, ForeignKey("sequences.id")),
    required("kind", String(64)),
    required("queue", String(16)),
    required("state", String(16)),
    required("priority", Integer),
    required("arguments", JSON),
    required("needs_left", Integer),
    required("attempt", Integer),
    required("attempts_left", Integer),
    required("heartbeats", Integer),
    required("cancel_reason", String(512)),
    required("stage", String(64)),
    required("done", Integer),
    required("total", Integer),
    optional("progress_ns", BigInteger),
    optional("result", JSON),
    required("failure_code", String(64)),
    required("failure", String(2000)),
    required("revision", Integer),
    required("created_ns", BigInteger),
    optional("started_ns", BigInteger),
    optional("finished_ns", BigInteger),
    required("traceparent", String(55), server_default=""),
    required("request_id", String(64), server_default=""),
    optional("ready_ns", BigInteger),
    Index("ix_jobs_owner_state", "owner_id", "state"),
    *indexes("root_id", "sequence_id"),
    Index("ix_jobs_state", "state", "id", "root_id"),
    Index("ix_jobs_finished", "finished_ns", "queue", "state"),
    partial_index("ix_jobs_ready_since", IS_READY, "queue", "ready_ns"),
    partial_index("ix_jobs_running", "state = 'running'", "queue", "owner_id"),
    partial_index("ix_jobs_runs", "id = root_id", "owner_id", "id"),
    partial_index("ix_jobs_run_kinds", "id = root_id", "kind", "id"),
    partial_index("ix_jobs_waiting", "state = 'queued' AND needs_left > 0", "queue"),
    partial_index("ix_jobs_sequence_runs", "id = root_id AND sequence_id IS NOT NULL", "sequence_id", "id"),
    partial_index("ix_jobs_ready", IS_READY, "queue", "owner_id", text("priority DESC"), "root_id", "id"),
)

table(
    "job_needs",
    key("job_id", ID, part_of("jobs.id")),
    key("needed_id", ID, part_of("jobs.id")),
    *indexes("needed_id"),
)

table(
    "job_attempts",
    key("job_id", ID, part_of("jobs.id")),
    key("number", Integer),
    required("worker", String(128)),
    required("outcome", String(16)),
    required("failure_code", String(64)),
    required("failure", String(2000)),
    optional("cpu_s", Double),
    optional("peak_bytes", BigInteger),
    required("started_ns", BigInteger),
    optional("finished_ns", BigInteger),
)

table(
    "job_lines",
    key("job_id", ID, part_of("jobs.id")),
    key("attempt", Integer),
    key("number", Integer),
    required("logged_ns", BigInteger),
    required("level", String(8)),
    required("event", String(1000)),
    required("facts", JSON),
)

table(
    "queues",
    key("name", String(16)),
    required("mode", String(16)),
)

table(
    "workers",
    key("name", String(128)),
    required("queues", String(64)),
    required("beats", BigInteger),
    required("started_ns", BigInteger),
    required("beat_ns", BigInteger),
    optional("held_bytes", BigInteger),
    optional("memory_free_bytes", BigInteger),
    optional("memory_bytes", BigInteger),
    optional("disk_free_bytes", BigInteger),
    optional("disk_bytes", BigInteger),
    *indexes("beat_ns"),
)
