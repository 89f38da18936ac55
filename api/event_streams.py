"""Job event streams: one database poll per tick serves all streams of this process.

**Conventions.** A version grows with every change of a subject: it sums the revisions of its jobs (and of the sequence
or submission). Streams wait on the event loop. Only the poll takes a thread and a database session, for one statement
and one snapshot per changed subject. While the database is unreachable, streams pause and stay open.
"""

import asyncio
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import anyio
import structlog
from anyio import CapacityLimiter, to_thread
from sqlalchemy import CompoundSelect, Select, func, literal, select, union_all
from sqlalchemy.exc import SQLAlchemyError
from sqlalchemy.orm import InstrumentedAttribute, Session

from api.errors import ApiError
from services.runtime.database.transactions import Database
from services.runtime.orm import Job, SequenceRow, SubmissionRow

TICK_S = 0.5
MAX_PER_CALLER = 8
MAX_STREAMS = 400
RETRY_AFTER_S = 5

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class StreamSubject:
    """The subject of a stream; `kind` is run (with its jobs), job (alone), sequence or submission (with their jobs)."""

    kind: str
    id: str


@dataclass(frozen=True)
class StreamSnapshot:
    """The state of a subject at a version, ready to send; it is the last one if `is_over`."""

    version: int
    json: str
    is_over: bool


Load = Callable[[Session, StreamSubject], tuple[str, bool]]


def too_many_streams(limit: int, whose: str) -> ApiError:
    return ApiError(
        "too_many_streams",
        f"{whose} already follow {limit} event streams; close a stream, or poll the job",
        {"Retry-After": str(RETRY_AFTER_S)},
    )


@dataclass
class _SubjectState:
    """One subject: its newest snapshot, the number of waiting streams, and the event that wakes them."""

    waiting: int = 0
    newest: StreamSnapshot | None = None
    changed: asyncio.Event = field(default_factory=asyncio.Event)


class Follower:
    """The poller of one process; runs on one event loop and sleeps while there are no streams."""

    def __init__(self, database: Database, load: Load, tick_s: float = TICK_S) -> None:
        self._database, self._load, self._tick_s = database, load, tick_s
        self._followed: dict[StreamSubject, _SubjectState] = {}
        self._streams: Counter[str] = Counter()
        self._thread = CapacityLimiter(1)  # apart from the threads that answer requests
        self._task: asyncio.Task[None] | None = None

    def sit(self, user_id: str) -> None:
        """Count one more stream of this user. Raises `too_many_streams`."""
        if self._streams[user_id] >= MAX_PER_CALLER:
            raise too_many_streams(MAX_PER_CALLER, "you")
        if self._streams.total() >= MAX_STREAMS:
            raise too_many_streams(MAX_STREAMS, "all users together")
        self._streams[user_id] += 1

    def leave(self, user_id: str) -> None:
        """Count one stream of this user less."""
        self._streams[user_id] -= 1
        self._streams += Counter()  # removes users without streams

    def look(self, subject: StreamSubject) -> StreamSnapshot:
        """Read the current state; must run in a thread, not on the event loop."""
        return self._changes({subject: None})[subject]

    async def snapshots(
        self, subject: StreamSubject, seen: int | None, patience_s: float
    ) -> AsyncGenerator[StreamSnapshot | None]:
        """Yield every snapshot newer than version `seen` until the end, and None after `patience_s` without one."""
        followed = self._followed.setdefault(subject, _SubjectState())
        followed.waiting += 1
        try:
            while True:
                self._wake()
                newest = await self._next(followed, seen, patience_s)
                yield newest
                seen = newest.version if newest else seen
                if newest and newest.is_over:
                    return
        finally:
            followed.waiting -= 1
            if not followed.waiting:
                self._followed.pop(subject, None)

    async def _next(self, followed: _SubjectState, seen: int | None, patience_s: float) -> StreamSnapshot | None:
        with anyio.move_on_after(patience_s):
            while followed.newest is None or followed.newest.version == seen:
                await followed.changed.wait()
            return followed.newest
        return None

    def _wake(self) -> None:
        if self._task is None or self._task.done():
            self._task = asyncio.get_running_loop().create_task(self._poll_while_followed())

    async def _poll_while_followed(self) -> None:
        while self._followed:
            known = {
                subject: state.newest.version if state.newest else None for subject, state in self._followed.items()
            }
            try:
                changes = await to_thread.run_sync(self._changes, known, limiter=self._thread)
            except SQLAlchemyError as error:
                log.warning("cannot read job changes; trying again", reason=str(error)[:200])
                changes = {}
            for subject, snapshot in changes.items():
                self._tell(subject, snapshot)
            await asyncio.sleep(self._tick_s)

    def _tell(self, subject: StreamSubject, snapshot: StreamSnapshot) -> None:
        followed = self._followed.get(subject)
        if followed is None:
            return
        followed.newest = snapshot
        followed.changed.set()
        followed.changed = asyncio.Event()

    def _changes(self, known: Mapping[StreamSubject, int | None]) -> dict[StreamSubject, StreamSnapshot]:
        with self._database.reading() as session:
            versions = {
                StreamSubject(kind, id): int(version) for kind, id, version in session.execute(_versions(known))
            }
            changed = {subject: versions.get(subject, 0) for subject in known}
            return {
                subject: StreamSnapshot(version, *self._load(session, subject))
                for subject, version in changed.items()
                if version != known[subject]
            }


def _versions(subjects: Mapping[StreamSubject, object]) -> CompoundSelect[str, str, int]:
    """Return one statement for all subjects that have jobs: (kind, id, version)."""

    def ids(kind: str) -> list[str]:
        return [subject.id for subject in subjects if subject.kind == kind]

    def summed(kind: str, column: InstrumentedAttribute[Any]) -> Select[str, str, int]:
        of_kind = select(literal(kind), column, func.sum(Job.revision)).where(column.in_(ids(kind)))
        return of_kind.group_by(column)

    of_jobs = (
        select(func.coalesce(func.sum(Job.revision), 0)).where(Job.sequence_id == SequenceRow.id).scalar_subquery()
    )
    sequences = select(literal("sequence"), SequenceRow.id, SequenceRow.revision + of_jobs)
    named = sequences.where(SequenceRow.id.in_(ids("sequence")))
    of_run = (
        select(func.coalesce(func.sum(Job.revision), 0)).where(Job.root_id == SubmissionRow.job_id).scalar_subquery()
    )
    submissions = select(literal("submission"), SubmissionRow.id, SubmissionRow.revision + of_run)
    submitted = submissions.where(SubmissionRow.id.in_(ids("submission")))
    return union_all(summed("run", Job.root_id), summed("job", Job.id), named, submitted)
