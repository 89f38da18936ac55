"""Instrumentation of job attempts: log context, span and counters.

**Conventions.** The span is a child of the span in which the job was queued, regardless of time and process; jobs
queued by an attempt are children of its own span. An attempt whose process is killed leaves no span: the sweeper, which
requeues its job, records a span for it.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Any

from opentelemetry.trace import Span, SpanKind
from opentelemetry.util.types import AttributeValue
from structlog.contextvars import bound_contextvars

from services.runtime.jobs.claims import Claim
from services.runtime.jobs.specs import queue_of
from services.runtime.orm import Job
from services.runtime.telemetry.counters import (
    JOB_CPU_SECONDS,
    JOB_SECONDS,
    JOB_WAIT_SECONDS,
    LEASES_EXPIRED,
    process_counters,
)
from services.runtime.telemetry.origins import context_of
from services.runtime.telemetry.process_usage import used_cpu_s
from services.runtime.telemetry.tracing import mark_failed, span


@dataclass
class JobInstrumentation:
    """`ended` records the outcome; without it the attempt was lost."""

    span: Span
    outcome: str = field(default="lost", init=False)

    def ended(self, outcome: str, code: str = "") -> None:
        """Set `outcome` as in the attempt's row, and the `code` of its failure, if any."""
        self.outcome = outcome
        if code:
            mark_failed(self.span, code)


@contextmanager
def instrumented(taken: Claim) -> Iterator[JobInstrumentation]:
    """Instrument the block as this attempt."""
    queue, begun_s, cpu_s, origin = queue_of(taken.kind), time.monotonic(), used_cpu_s(), taken.origin
    if origin.waited_s is not None:
        process_counters().observe(JOB_WAIT_SECONDS, (queue,), origin.waited_s)
    with (
        bound_contextvars(request_id=origin.request_id, **_log_context(taken)),
        _span(taken, origin.traceparent) as made,
    ):
        instrumentation = JobInstrumentation(made)
        try:
            yield instrumentation
        finally:
            made.set_attribute("stone.job.outcome", instrumentation.outcome)
            process_counters().observe(JOB_SECONDS, (taken.kind, instrumentation.outcome), time.monotonic() - begun_s)
            process_counters().add(JOB_CPU_SECONDS, (taken.kind,), used_cpu_s() - cpu_s)


def record_lost_attempt(job: Job) -> None:
    """Record an attempt that was lost after a lease without heartbeats."""
    process_counters().add(LEASES_EXPIRED, (job.kind,))
    claim = Claim(job.id, job.root_id, job.sequence_id, job.kind, job.attempt, {})
    with _span(claim, job.traceparent) as made:
        mark_failed(made, "lease_expired")
        made.set_attribute("stone.job.outcome", "lost")


def _span(taken: Claim, traceparent: str) -> AbstractContextManager[Span]:
    within = context_of(traceparent)
    return span(f"job {taken.kind}", SpanKind.CONSUMER, within=within, attributes=_span_facts(taken))


def _log_context(taken: Claim) -> Mapping[str, Any]:
    """Return the attempt's fields for each log line."""
    words = {"job_id": taken.job_id, "run_id": taken.root_id, "kind": taken.kind, "attempt": taken.attempt}
    return words if taken.sequence_id is None else {**words, "sequence_id": taken.sequence_id}


def _span_facts(taken: Claim) -> Mapping[str, AttributeValue]:
    facts: dict[str, AttributeValue] = {
        "stone.job.id": taken.job_id,
        "stone.run.id": taken.root_id,
        "stone.job.kind": taken.kind,
        "stone.job.attempt": taken.attempt,
    }
    return facts if taken.sequence_id is None else {**facts, "stone.sensors.sequence.id": taken.sequence_id}
