"""What is told of an attempt while it runs: whose it is in every line of the log, its span, and what it adds to counts.

**Conventions.** The span is a child of the one the job was queued in, however long ago and in whatever process that
was; what an attempt queues is a child of its own. An attempt whose process is killed leaves no span: the sweeper, which
gives its job back, leaves one that says so.
"""

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session
from structlog.contextvars import bound_contextvars

from services.runtime.jobs.claiming import Claim
from services.runtime.jobs.specs import queue_of
from services.runtime.orm import Job
from services.runtime.telemetry.meters import JOB_CPU_SECONDS, JOB_SECONDS, JOB_WAIT_SECONDS, LEASES_EXPIRED
from services.runtime.telemetry.tallies import tallies
from services.runtime.telemetry.tracing import Fact, SpanSpec, Traced, span
from services.runtime.usage import used_cpu_s


@dataclass(frozen=True)
class Origin:
    """Where a job comes from, and how long it was ready before it was claimed (None: not known)."""

    traceparent: str = ""
    request_id: str = ""
    waited_s: float | None = None


@dataclass
class Telling:
    """`ended` says how; what ends without a word was lost."""

    traced: Traced
    outcome: str = field(default="lost", init=False)

    def ended(self, outcome: str, code: str = "") -> None:
        """`outcome` as the attempt's row has it; `code` of its failure, empty without one."""
        self.outcome = outcome
        if code:
            self.traced.fault(code)


def origin_of(session: Session, taken: Claim) -> Origin:
    """As the job's row has it."""
    asked = select(Job.traceparent, Job.request_id, Job.ready_ns, Job.started_ns).where(Job.id == taken.job_id)
    traceparent, request_id, ready_ns, started_ns = session.execute(asked).one()
    waited_s = None if ready_ns is None or started_ns is None else max(started_ns - ready_ns, 0) / 1e9
    return Origin(traceparent, request_id, waited_s)


@contextmanager
def told(taken: Claim, origin: Origin) -> Iterator[Telling]:
    """All that is done inside is told as this attempt's."""
    queue, begun_s, cpu_s = queue_of(taken.kind), time.monotonic(), used_cpu_s()
    if origin.waited_s is not None:
        tallies().observe(JOB_WAIT_SECONDS, (queue,), origin.waited_s)
    spec = SpanSpec(f"job {taken.kind}", "consumer", origin.traceparent, _facts(taken))
    with bound_contextvars(request_id=origin.request_id, **_words(taken)), span(spec) as traced:
        telling = Telling(traced)
        try:
            yield telling
        finally:
            traced.note({"stone.job.outcome": telling.outcome})
            tallies().observe(JOB_SECONDS, (taken.kind, telling.outcome), time.monotonic() - begun_s)
            tallies().add(JOB_CPU_SECONDS, (taken.kind,), used_cpu_s() - cpu_s)


def tell_silence(job: Job) -> None:
    """An attempt was given up after silence for a lease."""
    tallies().add(LEASES_EXPIRED, (job.kind,))
    claim = Claim(job.id, job.root_id, job.sequence_id, job.kind, job.attempt, {})
    with span(SpanSpec(f"job {job.kind}", "consumer", job.traceparent, _facts(claim))) as traced:
        traced.fault("lease_expired")
        traced.note({"stone.job.outcome": "lost"})


def _words(taken: Claim) -> Mapping[str, Any]:
    """What each line of the log has of it."""
    words = {"job_id": taken.job_id, "run_id": taken.root_id, "kind": taken.kind, "attempt": taken.attempt}
    return words if taken.sequence_id is None else {**words, "sequence_id": taken.sequence_id}


def _facts(taken: Claim) -> Mapping[str, Fact]:
    facts: dict[str, Fact] = {
        "stone.job.id": taken.job_id,
        "stone.run.id": taken.root_id,
        "stone.job.kind": taken.kind,
        "stone.job.attempt": taken.attempt,
    }
    return facts if taken.sequence_id is None else {**facts, "stone.sequence.id": taken.sequence_id}
