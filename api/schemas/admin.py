"""The administrator's view over the wire: jobs with their children, queues, workers."""

from typing import Annotated, Any, Literal

from pydantic import Field

from api.schemas.base import ID_EXAMPLE, PLAIN, Answer, Body, IdText, Instant, Reason, example, example_of
from api.schemas.jobs import AttemptItem, FailureItem, JobDetail, JobItem

MOST_AT_ONCE = 200
JobAct = Literal["retry", "cancel", "terminate"]


class ReasonBody(Body):
    """Why an administrator does this; it is kept in the audit log."""

    model_config = example(reason="worker-3 is being replaced")

    reason: Reason


class CancelBody(Body):
    """Why the job is stopped, in its owner's words."""

    model_config = example(reason="wrong calibration")

    reason: Annotated[str, Field(pattern=PLAIN, max_length=500)] = ""


class AdminJobItem(JobItem):
    """A job with the names that it goes with, and how many tries it has left."""

    model_config = example(owner="ada", sequence="forest-3", attempts_left=2)

    owner: str
    sequence: str | None
    attempts_left: int


class JobCounts(Answer):
    """Number of jobs in each state; `dead` are single jobs that failed with no attempt left."""

    model_config = example(queued=3, running=2, succeeded=9120, failed=14, cancelled=7, dead=2)

    queued: int = 0
    running: int = 0
    succeeded: int = 0
    failed: int = 0
    cancelled: int = 0
    dead: int = 0


class JobActsBody(Body):
    """The same act on the runs of many jobs, and why."""

    model_config = example(act="retry", job_ids=[ID_EXAMPLE], reason="the disk was full")

    act: JobAct
    job_ids: Annotated[list[IdText], Field(min_length=1, max_length=MOST_AT_ONCE)]
    reason: Reason


class JobActItem(Answer):
    """Result of the act on one job: the new state of its run, or the reason of the refusal."""

    model_config = example(state="queued", failure=None)

    job_id: str
    root_id: str | None
    state: str | None
    failure: FailureItem | None


class AdminJobDetail(JobDetail):
    """A job with its attempts, and of a run the jobs that are unfinished or failed, newest first."""

    model_config = example(
        owner="ada",
        sequence="forest-3",
        attempts=[example_of(AttemptItem)],
        attempts_left=2,
        children=[],
        children_total=52,
    )

    owner: str
    sequence: str | None
    children: list[JobItem]
    children_total: int


class QueueItem(Answer):
    """A queue: `mode` is open, paused or draining; jobs ready, waiting for others, and running.

    `wake_ups` are broker notifications that no worker has acknowledged yet; null where the broker does not answer.
    `oldest_ready_s` is how
    long ago the oldest of the ready jobs was made. `per_minute` are the jobs that succeeded in each of the last 30
    minutes, the oldest first; `succeeded_lately` and `failed_lately` are of the last 15.
    """

    model_config = example(
        name="labeler",
        mode="open",
        ready=3,
        waiting=28,
        running=2,
        wake_ups=3,
        oldest_ready_s=41.5,
        succeeded_lately=57,
        failed_lately=1,
        per_minute=[0] * 26 + [3, 4, 4, 5],
    )

    name: str
    mode: str
    ready: int
    waiting: int
    running: int
    wake_ups: int | None
    oldest_ready_s: float | None
    succeeded_lately: int
    failed_lately: int
    per_minute: list[int]


class RunningAttempt(Answer):
    """An attempt that a worker process is running."""

    model_config = example(kind="labeler.surface", attempt=1, worker="worker-3:4711")

    job_id: str
    kind: str
    attempt: int
    worker: str


class WorkerItem(Answer):
    """A worker process by its heartbeat of `age_s` ago; silent if it missed its heartbeats.

    `held_bytes` is its own memory, the other sizes describe its machine; null if unknown. `job_id` is its current job.
    """

    model_config = example(
        name="worker-3:4711",
        queues=["eval", "ingest", "labeler"],
        is_silent=False,
        age_s=1.2,
        started_at="2026-05-03T09:00:00Z",
        kind="labeler.surface",
        attempt=1,
        held_bytes=412000000,
        memory_free_bytes=9000000000,
        memory_bytes=16000000000,
        disk_free_bytes=700000000000,
        disk_bytes=1000000000000,
    )

    name: str
    queues: list[str]
    is_silent: bool
    age_s: float
    started_at: Instant
    job_id: str | None
    kind: str | None
    attempt: int | None
    held_bytes: int | None
    memory_free_bytes: int | None
    memory_bytes: int | None
    disk_free_bytes: int | None
    disk_bytes: int | None


class WorkersAnswer(Answer):
    """Worker processes by their heartbeats, running attempts, and whether the broker responds.

    The broker sends workers no requests: their remote control is off.
    """

    model_config = example(is_broker_reachable=True)

    workers: list[WorkerItem]
    running: list[RunningAttempt]
    is_broker_reachable: bool


MOST_SCORINGS = 10_000


class AlarmItem(Answer):
    """A finding to review: `equal_content` and `near_equal_teams` across teams, `near_equal` within one team's day.

    `impossible_counts`: counting a sound file failed, or gave counts that no prediction has. `late_as_good`: an entry
    is as good in voxels that only later sweeps observed as elsewhere.

    `facts` name the submissions; `differing_ratio` is the least share of the evaluated voxels by which two differ.
    """

    model_config = example(
        kind="equal_content",
        subject=ID_EXAMPLE,
        facts={
            "submission_id": ID_EXAMPLE,
            "team_id": ID_EXAMPLE,
            "team": "Forest",
            "method": "VoxelNet",
            "others": [{"submission_id": ID_EXAMPLE, "team_id": ID_EXAMPLE, "team": "Lake", "method": "Ours"}],
        },
    )

    id: str
    phase_id: str
    kind: str
    subject: str
    facts: dict[str, Any]
    created_at: Instant
    dismissed_at: Instant | None


class GrantBody(Body):
    """Number of additional scorings of a team in a phase (negative to revoke), and the reason."""

    model_config = example(phase_id=ID_EXAMPLE, scorings=2, reason="the platform was away at the deadline")

    phase_id: IdText
    scorings: Annotated[int, Field(ge=-MOST_SCORINGS, le=MOST_SCORINGS)]
    reason: Reason


class GrantItem(Answer):
    """A grant in the ledger, and the scorings that the team has left.

    `next_at` is the time at which the next submission may be finalised, null for never; `limit` and `total_left` are
    null without a limit.
    """

    model_config = example(scorings=2, limit=5, used=3, reserved=0, total_left=7, next_at="2026-05-03T09:12:44.120000Z")

    id: str
    phase_id: str
    team_id: str
    scorings: int
    limit: int | None
    used: int
    reserved: int
    total_left: int | None
    next_at: Instant | None
    created_at: Instant
