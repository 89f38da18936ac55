"""Jobs over the wire: progress, failures and log lines."""

from typing import Any

from api.schemas.base import ID_EXAMPLE, Answer, Instant, example

STAGES_EXAMPLE: list[dict[str, Any]] = [
    {
        "kind": "labeler.fuse",
        "title": "Fuse sweeps",
        "total": 12,
        "done": 12,
        "running": 0,
        "failed": 0,
        "began_at": "2026-05-03T09:12:44.310000Z",
        "ended_at": "2026-05-03T09:13:05Z",
        "busy_s": 40.2,
    },
    {
        "kind": "labeler.surface",
        "title": "Reconstruct the surface",
        "total": 40,
        "done": 11,
        "running": 2,
        "failed": 0,
        "began_at": "2026-05-03T09:12:58Z",
        "ended_at": "2026-05-03T09:13:11Z",
        "busy_s": 22.9,
    },
]


class FailureItem(Answer):
    """Why something ended badly: `code` for programs, `sentence` for people."""

    model_config = example(code="no_poses", sentence="the bag has no odometry")

    code: str
    sentence: str


class ProgressItem(Answer):
    """`done` of `total` in units of the job (for a run: its jobs); `rate_per_s` of a single running job, else null.

    `eta_s` is the estimate of the seconds left, rounded up; null if unknown, after the end, or for a job within a run,
    whose run has the estimate.
    """

    model_config = example(stage="labeler.surface", done=23, total=52, eta_s=40)

    stage: str
    done: int
    total: int
    rate_per_s: float | None
    eta_s: int | None


class StageItem(Answer):
    """Jobs of one kind within a run, with a title for people.

    `began_at` is the start of the first of them, `ended_at` the end of the last that has ended, null before; `busy_s`
    is the total duration of the succeeded jobs.
    """

    model_config = example(**STAGES_EXAMPLE[1])

    kind: str
    title: str = ""
    total: int
    done: int
    running: int
    failed: int
    began_at: Instant | None = None
    ended_at: Instant | None = None
    busy_s: float = 0.0


class JobItem(Answer):
    """A job or a run; `title` describes its `kind` for people. `queue` is empty for a run, which groups its jobs."""

    model_config = example(
        kind="sequence.process",
        title="Label the sequence",
        queue="",
        state="running",
        priority=0,
        attempt=0,
        failure=None,
        cancel_reason="",
        revision=31,
        started_at="2026-05-03T09:12:44.310000Z",
    )

    id: str
    root_id: str
    owner_id: str
    sequence_id: str | None
    kind: str
    title: str = ""
    queue: str
    state: str
    priority: int
    attempt: int
    progress: ProgressItem
    failure: FailureItem | None
    cancel_reason: str
    revision: int
    created_at: Instant
    started_at: Instant | None
    finished_at: Instant | None


class AttemptItem(Answer):
    """One try at a job by one process; `outcome` is empty while it runs."""

    model_config = example(
        number=1,
        worker="worker-3:4711",
        outcome="lost",
        failure={"code": "worker_lost", "sentence": "attempt 1 sent no heartbeat for 20 s"},
        peak_bytes=412000000,
        started_at="2026-05-03T09:12:44.310000Z",
        finished_at="2026-05-03T09:13:11Z",
    )

    number: int
    worker: str
    outcome: str
    failure: FailureItem | None
    peak_bytes: int | None
    started_at: Instant
    finished_at: Instant | None


class JobDetail(JobItem):
    """A job with its attempts and what it answered; a run with its stages."""

    model_config = example(stages=STAGES_EXAMPLE, attempts=[], attempts_left=0)

    stages: list[StageItem]
    attempts: list[AttemptItem]
    attempts_left: int
    result: dict[str, Any] | None


class LogLine(Answer):
    """A log line of an attempt."""

    model_config = example(
        attempt=1,
        number=17,
        logged_ns=1777799570000000000,
        logged_at="2026-05-03T09:12:50Z",
        level="info",
        event="tile meshed",
        facts={"triangles": 48210},
    )

    job_id: str
    attempt: int
    number: int
    logged_ns: int
    logged_at: Instant
    level: str
    event: str
    facts: dict[str, Any]


class LogPage(Answer):
    """Lines in order; `next` is given as `after` to read on, also when there is nothing more to read yet."""

    model_config = example(items=[], next=f"1777799570000000000.{ID_EXAMPLE}.1.17")

    items: list[LogLine]
    next: str | None
