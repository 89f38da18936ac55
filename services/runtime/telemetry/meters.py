"""What processes count, by name: the one list that counting, telling and exposing go by.

**Conventions.** Names are those that Prometheus shows, without its `_total`. Labels take few values: kinds, outcomes,
queues, directions; never an id or a name. A meter with `bounds` is a histogram, whose buckets end there.
"""

from dataclasses import dataclass

SECONDS = (0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0, 1800.0)
ANSWERS = (0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1.0, 2.5, 5.0, 10.0, 60.0)
WAITS = (0.1, 0.5, 1.0, 5.0, 15.0, 60.0, 300.0, 900.0, 3600.0, 14400.0, 86400.0)


@dataclass(frozen=True)
class Meter:
    """A counter, or with `bounds` a histogram."""

    name: str
    told: str
    labels: tuple[str, ...]
    bounds: tuple[float, ...] = ()


REQUESTS = Meter("stone_requests", "Requests answered", ("method", "route", "status"))
REQUEST_SECONDS = Meter("stone_request_seconds", "How long an answer took", ("method", "route"), ANSWERS)
REQUEST_BYTES = Meter("stone_request_bytes", "Bytes of bodies that came in and went out", ("direction",))
JOB_SECONDS = Meter("stone_job_seconds", "How long attempts at jobs took", ("kind", "outcome"), SECONDS)
JOB_WAIT_SECONDS = Meter("stone_job_wait_seconds", "How long jobs were ready before a worker came", ("queue",), WAITS)
JOB_CPU_SECONDS = Meter("stone_job_cpu_seconds", "Processor time of attempts, their children's too", ("kind",))
FRAMES = Meter("stone_frames", "Frames that were labelled, or counted against a ground truth", ("work",))
STORE_BYTES = Meter("stone_store_bytes", "Bytes that were written to and read from the store", ("direction",))
LEASES_EXPIRED = Meter("stone_leases_expired", "Attempts given up after silence for a lease", ("kind",))
BELLS_RUNG_AGAIN = Meter("stone_bells_rung_again", "Bells rung for ready jobs that none stood for", ("queue",))
CHORE_FAILURES = Meter("stone_chore_failures", "Chores of the sweeper that an outage kept from being done", ("chore",))

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
    BELLS_RUNG_AGAIN,
    CHORE_FAILURES,
)
