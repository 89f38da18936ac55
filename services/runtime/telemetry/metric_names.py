"""Definitions of all counters and histograms.

**Conventions.** Names are those that Prometheus shows, without its `_total`. Labels take few values: kinds, outcomes,
queues, directions; never an id or a name. A meter with `bounds` is a histogram, whose buckets end there.
"""

from dataclasses import dataclass

SECONDS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)
ANSWERS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
WAITS = (0.1, 0.5, 1.0, 5.0, 15.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, 86400.0)


@dataclass(frozen=True)
class MetricDefinition:
    """A counter, or with `bounds` a histogram."""

    name: str
    told: str
    labels: tuple[str, ...]
    bounds: tuple[float, ...] = ()


REQUESTS = MetricDefinition("stone_requests", "Requests answered", ("method", "route", "status"))
REQUEST_SECONDS = MetricDefinition("stone_request_seconds", "How long an answer took", ("method", "route"), ANSWERS)
REQUEST_BYTES = MetricDefinition("stone_request_bytes", "Bytes of bodies that came in and went out", ("direction",))
JOB_SECONDS = MetricDefinition("stone_job_seconds", "How long attempts at jobs took", ("kind", "outcome"), SECONDS)
JOB_WAIT_SECONDS = MetricDefinition(
    "stone_job_wait_seconds", "How long jobs were ready before a worker came", ("queue",), WAITS
)
JOB_CPU_SECONDS = MetricDefinition(
    "stone_job_cpu_seconds", "Processor time of attempts, their children's too", ("kind",)
)
FRAMES = MetricDefinition("stone_frames", "Frames that were labelled, or counted against a ground truth", ("work",))
STORE_BYTES = MetricDefinition(
    "stone_store_bytes", "Bytes that were written to and read from the store", ("direction",)
)
LEASES_EXPIRED = MetricDefinition("stone_leases_expired", "Attempts given up after silence for a lease", ("kind",))
WAKE_UPS_RESENT = MetricDefinition(
    "stone_wake_ups_resent", "Wake-ups sent again for ready jobs whose own were lost", ("queue",)
)
CHORE_FAILURES = MetricDefinition(
    "stone_chore_failures", "Chores of the sweeper that an outage kept from being done", ("chore",)
)

METERS = (
    REQUESTS,
    REQUEST_SECONDS,
    REQUEST_BYTES,
    JOB_SECONDS,
    JOB_WAIT_SECONDS,
    JOB_CPU_SECONDS,
    FRAMES,
    STORE_BYTES,
    LEASES_EXPIRED,
    WAKE_UPS_RESENT,
    CHORE_FAILURES,
)

RENAMED = {"stone_queue_bells": "stone_queue_wake_ups", "stone_bells_rung_again": WAKE_UPS_RESENT.name}
"""New names of metrics by old ones, under which they are exposed too for one release."""
