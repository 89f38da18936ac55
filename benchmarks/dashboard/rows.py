"""The rows that `benchmarks.dashboard` reads: runs of all states with their jobs and owners, and worker processes."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from sqlalchemy import insert
from sqlalchemy.orm import Session

from services.runtime.access import users
from services.runtime.orm import Job, JobAttempt, SequenceRow, User, Worker, new_id
from services.runtime.orm.base import now_ns

OWNERS = ("ada", "grace", "edsger", "barbara", "tony", "leslie", "john", "frances")
STAGES = ("ingest.open", "ingest.synchronise", "labeler.fuse", "labeler.surface", "labeler.label")
STATES = ("succeeded",) * 40 + ("failed",) * 4 + ("cancelled",) * 2 + ("queued",) * 3 + ("running",)
SECOND_NS = 10**9
LOST = {"failure_code": "worker_lost", "failure": "attempt 3 gave no sign of life for 20 s"}
GIB = 2**30


@dataclass(frozen=True)
class FilledDashboard:
    """The inserted rows: their number, and a running run."""

    jobs: int
    running_id: str


def fill(session: Session, runs: int, workers: int, silent: int = 2) -> FilledDashboard:
    """Insert `runs` runs of five jobs each, the newest last, within the last hours, and `workers` processes."""
    people = [users.create_user(session, name, "curator") for name in OWNERS]
    session.flush()
    sequences = [_sequence(number, person) for number, person in enumerate(people)]
    session.add_all(sequences)
    session.flush()
    at_ns = now_ns()
    rows = [row for number in range(runs) for row in _run(number, runs, sequences[number % len(sequences)], at_ns)]
    for some in range(0, len(rows), 5000):
        session.execute(insert(Job), rows[some : some + 5000])
    busy = [row for row in rows if row["queue"] and row["state"] == "running"]
    names = [f"worker-{number // 8}:{4700 + number}" for number in range(workers)]
    session.add_all(_worker(number, name, at_ns, number >= workers - silent) for number, name in enumerate(names))
    session.flush()
    held = zip(busy, names[: workers - silent], strict=False)
    session.add_all(JobAttempt(job_id=row["id"], number=1, worker=name, started_ns=at_ns) for row, name in held)
    return FilledDashboard(len(rows), next(row["root_id"] for row in reversed(rows) if row["state"] == "running"))


def _sequence(number: int, owner: User) -> SequenceRow:
    return SequenceRow(id=new_id(), owner_id=owner.id, name=f"forest-{number}", environment="forest", region="Gyeonggi")


def _run(number: int, runs: int, sequence: SequenceRow, at_ns: int) -> Iterator[dict[str, Any]]:
    state = STATES[number * 7 % len(STATES)]
    made_ns = at_ns - (runs - number) * 6 * SECOND_NS
    root_id = new_id()
    yield _row(root_id, root_id, "sequence.process", state, sequence, made_ns, len(STAGES) + 1)
    for position, kind in enumerate(STAGES):
        child = _row(new_id(), root_id, kind, _state(state, position), sequence, made_ns, position + 1)
        yield child | {"queue": kind.partition(".")[0], "needs_left": int(child["state"] == "queued" and position > 0)}


def _row(
    job_id: str, root_id: str, kind: str, state: str, sequence: SequenceRow, made_ns: int, position: int
) -> dict[str, Any]:
    is_over, has_begun = state in ("succeeded", "failed", "cancelled"), state != "queued"
    return {
        "id": job_id,
        "root_id": root_id,
        "owner_id": sequence.owner_id,
        "sequence_id": sequence.id,
        "kind": kind,
        "queue": "",
        "state": state,
        "arguments": {},
        "needs_left": 0,
        "attempt": int(has_begun),
        "attempts_left": 0 if state == "failed" else 2,
        "stage": "tiles" if state == "running" else "",
        "done": 11 if state == "running" else 0,
        "total": 40 if state == "running" else 0,
        "created_ns": made_ns,
        "started_ns": made_ns + (position - 1) * 2 * SECOND_NS if has_begun else None,
        "finished_ns": made_ns + position * 2 * SECOND_NS if is_over else None,
        "failure_code": LOST["failure_code"] if state == "failed" else "",
        "failure": LOST["failure"] if state == "failed" else "",
    }


def _state(of_run: str, position: int) -> str:
    """Return the state of a job of the run; runs fail or are still running at their last job but one."""
    if of_run in ("succeeded", "queued") or position < len(STAGES) - 2:
        return "queued" if of_run == "queued" else "succeeded"
    return of_run if position == len(STAGES) - 2 else {"running": "queued"}.get(of_run, "cancelled")


def _worker(number: int, name: str, at_ns: int, is_silent: bool) -> Worker:
    beat_ns = at_ns - 300 * SECOND_NS if is_silent else at_ns + 3600 * SECOND_NS  # stays fresh during the measurement
    sizes = {"memory_bytes": 64 * GIB, "disk_free_bytes": (60 + number) * 10**9, "disk_bytes": 1000 * 10**9}
    free = (50 - number % 48) * GIB
    return Worker(
        name=name, queues="eval,ingest,labeler", beats=9, started_ns=at_ns - 7200 * SECOND_NS, beat_ns=beat_ns,
        held_bytes=400 * 2**20 + number * 2**22, memory_free_bytes=free, **sizes,
    )  # fmt: skip
