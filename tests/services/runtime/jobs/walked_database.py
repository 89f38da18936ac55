"""The real transitions of jobs, run on an SQLite database in memory that is put into any state seen before.

**Conventions.** A `Rows` is what the rows say, with jobs by their place in the order of their ids, the run's own being
0 (a job that is its own run is 0 too). What a transition makes of `Rows` is computed once: it hangs on nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from sqlalchemy import create_engine, event, select
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from sqlalchemy.pool import StaticPool

from services.runtime.database.transactions import Database
from services.runtime.jobs.claims import Claim
from services.runtime.orm import Base, FigureRow, Job, JobAttempt, JobLine
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform

TABLES = (
    "users",
    "sequences",
    "jobs",
    "job_needs",
    "job_attempts",
    "job_lines",
    "queues",
    "figures",
    "notification_events",
)


class JobState(NamedTuple):
    """What the transitions of a job hang on."""

    state: str
    attempt: int
    attempts_left: int
    needs_left: int
    heartbeats: int
    is_asked: bool
    has_failed: bool
    commits: int


class Rows(NamedTuple):
    """`lines` and `attempts` are (job, attempt) with their number or outcome."""

    jobs: tuple[JobState, ...]
    lines: tuple[tuple[int, int, int], ...]
    attempts: tuple[tuple[int, int, str], ...]


class MemoryDatabase(Database):
    """One connection to a small database that its process forgets."""

    def __init__(self) -> None:
        connect = {"isolation_level": None, "check_same_thread": False}
        self.engine = create_engine("sqlite://", poolclass=StaticPool, connect_args=connect)
        event.listen(self.engine, "begin", lambda connection: connection.exec_driver_sql("BEGIN"))
        self._writing = self._readers = self.engine
        self._wake_up = lambda queue, times: None
        self.driver = self.engine.raw_connection().driver_connection
        self.driver.execute("PRAGMA page_size=1024")
        Base.metadata.create_all(self.engine, [Base.metadata.tables[name] for name in TABLES])


@dataclass
class Memory:
    """`apply(rows, key, act)` runs `act` where the database says `rows`; what it left, and what `act` answered."""

    platform: Platform
    transitions: int = 0
    _pages: dict[Rows, bytes] = field(default_factory=dict)
    _ids: dict[Rows, list[str]] = field(default_factory=dict)
    _known: dict[tuple[Rows, object], tuple[Rows, Any]] = field(default_factory=dict)

    def begin(self) -> Rows:
        """The state that the database is in now."""
        rows, ids = _rows(self.platform.database)
        if rows not in self._pages:
            self._pages[rows], self._ids[rows] = self._database.driver.serialize(), ids
        return rows

    def apply(self, rows: Rows, key: object, act: Callable[[list[str]], Any]) -> tuple[Rows, Any]:
        """`act` is given the jobs' ids; a driver's error is answered as itself."""
        if (rows, key) not in self._known:
            self._database.driver.deserialize(self._pages[rows])
            try:
                answer = act(self._ids[rows])
            except OperationalError as error:
                answer = error
            self._known[rows, key] = self.begin(), answer
            self.transitions += 1
        return self._known[rows, key]

    @property
    def _database(self) -> MemoryDatabase:
        database = self.platform.database
        assert isinstance(database, MemoryDatabase)
        return database


def claim_of(ids: list[str], job: int, attempt: int) -> Claim:
    """The claim of whoever took this attempt."""
    return Claim(ids[job], ids[0], None, "ingest.ok", attempt, {})


def count_commit(job_id: str) -> Callable[[Session], None]:
    """Rows of an outcome that tell how often it was committed."""

    def commit(session: Session) -> None:
        row = session.get(FigureRow, job_id) or FigureRow(name=job_id, value=0, measured_ns=now_ns())
        row.value += 1
        session.add(row)

    return commit


def _rows(database: Database) -> tuple[Rows, list[str]]:
    with database.reading() as session:
        jobs = session.scalars(select(Job).order_by(Job.id)).all()
        place = {job.id: number for number, job in enumerate(jobs)}
        commits = {row.name: int(row.value) for row in session.scalars(select(FigureRow))}
        states = tuple(_state(job, commits.get(job.id, 0)) for job in jobs)
        lines = sorted((place[line.job_id], line.attempt, line.number) for line in session.scalars(select(JobLine)))
        tries = sorted((place[one.job_id], one.number, one.outcome) for one in session.scalars(select(JobAttempt)))
    return Rows(states, tuple(lines), tuple(tries)), list(place)


def _state(job: Job, commits: int) -> JobState:
    counts = (job.attempt, job.attempts_left, job.needs_left, job.heartbeats)
    return JobState(job.state, *counts, bool(job.cancel_reason), bool(job.failure_code), commits)
