"""ORM models of jobs, their dependencies, attempts and log lines, queues and workers.

**Conventions.** `state` is queued, running, succeeded, failed or cancelled; only `services/runtime/jobs` changes it,
always by compare-and-set. A job whose `queue` is empty is a run: it groups its children, and no worker takes it.
"""

from typing import Any

from sqlalchemy import JSON, ForeignKey, Index, String, text
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Bytes, Count, Id, Ns, Record, new_id, now_ns, partial_index
from services.runtime.telemetry.origins import origin_request, origin_trace

IS_READY = "state = 'queued' AND needs_left = 0"
IS_WAITING = "state = 'queued' AND needs_left > 0"
IS_RUNNING = "state = 'running'"
IS_RUN = "id = root_id"
IS_RUN_OF_SEQUENCE = f"{IS_RUN} AND sequence_id IS NOT NULL"  # so that only queries about a sequence use it
"""The predicates of the partial indexes. A query uses an index only if it repeats its predicate in literals: a generic
plan of a prepared statement does not contain its parameters.
"""
READY = text(IS_READY)


class Job(Base):
    """`needs_left` jobs must succeed before this one is ready; `heartbeats` grows while an attempt lives.

    From `ready_ns` on a worker may take it; null before. `traceparent` and `request_id` are those of its request.
    """

    __tablename__ = "jobs"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    root_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), index=True)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    sequence_id: Mapped[Id | None] = mapped_column(ForeignKey("sequences.id"), index=True)
    kind: Mapped[str] = mapped_column(String(64))
    queue: Mapped[str] = mapped_column(String(16), default="")
    state: Mapped[str] = mapped_column(String(16), default="queued")
    priority: Mapped[int] = mapped_column(default=0)
    arguments: Mapped[Record] = mapped_column(default=dict)
    needs_left: Mapped[int] = mapped_column(default=0)
    attempt: Mapped[int] = mapped_column(default=0)
    attempts_left: Mapped[int] = mapped_column(default=3)
    heartbeats: Mapped[int] = mapped_column(default=0)
    cancel_reason: Mapped[str] = mapped_column(String(512), default="")
    stage: Mapped[str] = mapped_column(String(64), default="")
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int] = mapped_column(default=0)
    progress_ns: Mapped[Ns | None]
    result: Mapped[Record | None] = mapped_column(JSON)
    failure_code: Mapped[str] = mapped_column(String(64), default="")
    failure: Mapped[str] = mapped_column(String(2000), default="")
    revision: Mapped[int] = mapped_column(default=1)
    traceparent: Mapped[str] = mapped_column(String(55), default=origin_trace, server_default=text("''"))
    request_id: Mapped[str] = mapped_column(String(64), default=origin_request, server_default=text("''"))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)
    ready_ns: Mapped[Ns | None]
    started_ns: Mapped[Ns | None]
    finished_ns: Mapped[Ns | None]

    __table_args__ = (
        Index("ix_jobs_ready_since", "queue", "ready_ns", sqlite_where=READY, postgresql_where=READY),
        partial_index("ix_jobs_ready", IS_READY, "queue", "owner_id", text("priority DESC"), "root_id", "id"),
        partial_index("ix_jobs_waiting", IS_WAITING, "queue"),
        partial_index("ix_jobs_running", IS_RUNNING, "queue", "owner_id"),
        partial_index("ix_jobs_runs", IS_RUN, "owner_id", "id"),
        partial_index("ix_jobs_run_kinds", IS_RUN, "kind", "id"),
        partial_index("ix_jobs_sequence_runs", IS_RUN_OF_SEQUENCE, "sequence_id", "id"),
        Index("ix_jobs_owner_state", "owner_id", "state"),
        Index("ix_jobs_state", "state", "id", "root_id"),
        Index("ix_jobs_finished", "finished_ns", "queue", "state"),
    )


class JobNeed(Base):
    """`job_id` waits until `needed_id` has succeeded."""

    __tablename__ = "job_needs"
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    needed_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True, index=True)


class JobAttempt(Base):
    """One process's attempt at a job. `outcome` is empty, then succeeded, failed, cancelled or lost."""

    __tablename__ = "job_attempts"
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    worker: Mapped[str] = mapped_column(String(128))
    outcome: Mapped[str] = mapped_column(String(16), default="")
    failure_code: Mapped[str] = mapped_column(String(64), default="")
    failure: Mapped[str] = mapped_column(String(2000), default="")
    cpu_s: Mapped[float | None]
    peak_bytes: Mapped[Ns | None]
    started_ns: Mapped[Ns] = mapped_column(default=now_ns)
    finished_ns: Mapped[Ns | None]


class JobLine(Base):
    """A structured log line of an attempt, numbered from 0."""

    __tablename__ = "job_lines"
    job_id: Mapped[Id] = mapped_column(ForeignKey("jobs.id", ondelete="CASCADE"), primary_key=True)
    attempt: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    logged_ns: Mapped[Ns] = mapped_column(default=now_ns)
    level: Mapped[str] = mapped_column(String(8))
    event: Mapped[str] = mapped_column(String(1000))
    facts: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)


class Queue(Base):
    """The state of a queue: open, paused (no job starts) or draining (queued jobs run, no job is added)."""

    __tablename__ = "queues"
    name: Mapped[str] = mapped_column(String(16), primary_key=True)
    mode: Mapped[str] = mapped_column(String(16), default="open")


class Worker(Base):
    """A process that takes jobs, by its last report; `beat_ns` is on the database's clock.

    `name` is host and pid, as in attempts; `queues` are the queues that it serves. Memory and disk are its machine's
    (or its container's, if lower), if known.
    """

    __tablename__ = "workers"
    name: Mapped[str] = mapped_column(String(128), primary_key=True)
    queues: Mapped[str] = mapped_column(String(64), default="")
    beats: Mapped[Count] = mapped_column(default=0)
    started_ns: Mapped[Ns]
    beat_ns: Mapped[Ns] = mapped_column(index=True)
    held_bytes: Mapped[Bytes | None]
    memory_free_bytes: Mapped[Bytes | None]
    memory_bytes: Mapped[Bytes | None]
    disk_free_bytes: Mapped[Bytes | None]
    disk_bytes: Mapped[Bytes | None]
