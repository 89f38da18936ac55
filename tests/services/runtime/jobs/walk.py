"""Every history of a small run: two workers, two sweepers, an owner and faults, in whatever order.

**Conventions.** Breadth first over states; a step is one transaction of one of them, run by the real code
(`Memory`). Time is left out: a sweeper may find any running attempt silent for a lease, since any worker may
be slow, and is held to what it saw. Controls and faults are counted by a budget; all other steps are free, and whoever
takes only free steps must come to an end.
"""

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from sqlalchemy import create_engine, event, select
from sqlalchemy.exc import OperationalError
from sqlalchemy.orm import Session
from sqlalchemy.pool import StaticPool

from services.runtime.database.transactions import Database
from services.runtime.jobs import completion, control
from services.runtime.jobs.claims import Claim, claim, start_run
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.errors import JobStateError
from services.runtime.jobs.execution import Reporter
from services.runtime.jobs.lease_sweep import lose_silent
from services.runtime.jobs.specs import JobSpec, Outcome
from services.runtime.orm import Base, FigureRow, Job, JobAttempt, JobLine
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from tests.services.runtime.jobs.outages import LostAnswers

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


MOST_BEATS = 1
MOST_ATTEMPTS = 2
FAILURE = Failure("odd", "as the walk went")


class Work(NamedTuple):
    """An attempt in the hands of a process. `phase`: claimed, working, unsure (its success was not answered)."""

    job: int
    attempt: int
    phase: str = "claimed"
    has_line: bool = True
    is_asked: bool = False


class Silence(NamedTuple):
    """What a sweeper saw stand still for a lease, and is about to take away."""

    job: int
    attempt: int
    beats: int


class World(NamedTuple):
    """`budget`: how many controls (cancel, terminate, retry) and faults there may still be."""

    rows: Rows
    workers: tuple[Work | None, Work | None]
    sweepers: tuple[Silence | None, Silence | None]
    controls: int
    faults: int


Step = tuple[str, bool, World]
"""Its name, whether it is free, and where it leads."""


@dataclass
class Walk:
    """`then`: what follows the first job's success; `lost` loses answers of commits."""

    memory: Memory
    lost: LostAnswers
    then: tuple[JobSpec, ...] = ()
    ended: list[str] = field(default_factory=list)

    def steps(self, world: World) -> Iterator[Step]:
        for place in (0, 1):
            yield from self._of_worker(world, place)
            yield from self._of_sweeper(world, place)
        if world.controls:
            for name in ("cancel", "terminate", "retry"):
                rows, is_done = self._transact(world.rows, name, partial(_steer, name=name))
                if is_done:
                    yield name, False, world._replace(rows=rows, controls=world.controls - 1)

    def beat(self, rows: Rows, work: Work, unanswered: int = 0) -> tuple[Rows, Work | None, bool]:
        """A turn of the real reporter, whose commit may not be answered; the rows, the process, whether it ended."""

        def speak(ids: list[str]) -> tuple[bool, bool, bool]:
            self.ended.clear()
            reporter = Reporter(self.memory.platform, claim_of(ids, work.job, work.attempt))
            if work.has_line:
                reporter.log("opened the bag")
            self.lost.after(unanswered)
            reporter._speak_once()
            self.lost.after(0)
            return bool(reporter._lines), bool(reporter._cancel_reason), bool(self.ended)

        key = ("beat", work.job, work.attempt, work.has_line, unanswered)
        after, (has_line, is_asked, is_over) = self.memory.apply(rows, key, speak)
        heard = work._replace(has_line=has_line, is_asked=work.is_asked or is_asked)
        return after, None if is_over else heard, is_over

    def _of_worker(self, world: World, place: int) -> Iterator[Step]:
        work = world.workers[place]
        if work is None:
            yield from self._taking(world, place)
        elif work.phase == "claimed":
            rows, _ = self._held(world.rows, "start", work, start_run)
            yield "start", True, _after(world, rows, place, work._replace(phase="working"))
        elif work.phase == "unsure":
            rows, _ = self._held(
                world.rows, "lose", work, lambda session, held: completion.lose(session, held, FAILURE)
            )
            yield "give back", True, _after(world, rows, place, None)
        else:
            yield from self._working(world, place, work)
        if work is not None and world.faults:
            yield "killed", False, _after(world, world.rows, place, None, faults=1)

    def _taking(self, world: World, place: int) -> Iterator[Step]:
        rows, taken = self._transact(world.rows, "claim", _claim)
        if taken is not None:
            yield "claim", True, _after(world, rows, place, Work(*taken))
            if world.faults:
                yield "claim unanswered", False, _after(world, rows, place, None, faults=1)

    def _working(self, world: World, place: int, work: Work) -> Iterator[Step]:
        if world.rows.jobs[work.job].heartbeats < MOST_BEATS or work.has_line:
            rows, heard, _ = self.beat(world.rows, work)
            yield "beat", True, _after(world, rows, place, heard)
            if world.faults:
                rows, heard, _ = self.beat(world.rows, work, unanswered=1)
                yield "beat unanswered", False, _after(world, rows, place, heard, faults=1)
        if work.is_asked:
            rows, _ = self._held(world.rows, "cancelled", work, completion.cancelled)
            yield "stopped", True, _after(world, rows, place, None)
            return
        rows, _ = self._held(world.rows, "succeed", work, self._succeed)
        yield "succeed", True, _after(world, rows, place, None)
        if world.faults:
            yield "succeed unanswered", False, _after(world, rows, place, work._replace(phase="unsure"), faults=1)
            for name, end in (("fail", completion.fail), ("lose", completion.lose)):
                rows, _ = self._held(world.rows, name, work, partial(end, failure=FAILURE))
                yield name, False, _after(world, rows, place, None, faults=1)

    def _of_sweeper(self, world: World, place: int) -> Iterator[Step]:
        seen = world.sweepers[place]
        if seen is not None:
            rows, _ = self._transact(world.rows, ("silent", seen), lambda session, ids: _lose(session, ids, seen))
            yield "take away", True, world._replace(rows=rows, sweepers=_put(world.sweepers, place, None))
            return
        for number, job in enumerate(world.rows.jobs):
            if job.state == "running" and job.attempt:
                silence = Silence(number, job.attempt, job.heartbeats)
                yield "find silent", True, world._replace(sweepers=_put(world.sweepers, place, silence))

    def _succeed(self, session: Session, held: Any) -> bool:
        is_first = session.get_one(Job, held.job_id).arguments.get("is_first", False)
        outcome = Outcome(then=self.then if is_first else (), commit=count_commit(held.job_id))
        return completion.succeed(session, held, outcome, MOST_ATTEMPTS)

    def _held(self, rows: Rows, name: str, work: Work, act: Callable[[Session, Any], Any]) -> tuple[Rows, Any]:
        key = (name, work.job, work.attempt)
        return self._transact(rows, key, lambda session, ids: act(session, claim_of(ids, work.job, work.attempt)))

    def _transact(self, rows: Rows, key: object, act: Callable[[Session, list[str]], Any]) -> tuple[Rows, Any]:
        def transaction(ids: list[str]) -> Any:
            with self.memory.platform.database.transaction() as session:
                return act(session, ids)

        return self.memory.apply(rows, key, transaction)


@dataclass
class Reached:
    """Every state, the step by which it was first reached, and the free steps between them."""

    origin: dict[World, tuple[str, World] | None]
    free: dict[World, list[World]]
    steps: int

    def history(self, world: World) -> list[str]:
        """The shortest way there."""
        names = []
        while (came := self.origin[world]) is not None:
            names.append(came[0])
            world = came[1]
        return names[::-1]

    def endless(self) -> list[World]:
        """States from which free steps alone may go on for ever: what is left when ends are taken off one by one."""
        before: dict[World, list[World]] = {world: [] for world in self.free}
        for world, following in self.free.items():
            for after in following:
                before[after].append(world)
        left = {world: len(following) for world, following in self.free.items()}
        ends = deque(world for world, count in left.items() if not count)
        while ends:
            for world in before[ends.popleft()]:
                left[world] -= 1
                if not left[world]:
                    ends.append(world)
        return [world for world, count in left.items() if count]


def walk(walked: Walk, controls: int, faults: int, check: Callable[[World], None]) -> Reached:
    """Go everywhere from where the database stands; `check` sees every state."""
    first = World(walked.memory.begin(), (None, None), (None, None), controls, faults)
    reached, waiting = Reached({first: None}, {}, 0), deque([first])
    while waiting:
        world = waiting.popleft()
        try:
            check(world)
        except AssertionError as error:
            raise AssertionError(f"{error} after {reached.history(world)}: {world}") from error
        free = []
        for name, is_free, after in walked.steps(world):
            after = _sorted(after)
            reached.steps += 1
            if is_free:
                free.append(after)
            if after not in reached.origin:
                reached.origin[after] = (name, world)
                waiting.append(after)
        reached.free[world] = free
    return reached


def _sorted(world: World) -> World:
    """Two workers, and two sweepers, are alike: which of them is where makes no other state."""
    workers = sorted(world.workers, key=lambda one: one or ())
    sweepers = sorted(world.sweepers, key=lambda one: one or ())
    return world._replace(workers=tuple(workers), sweepers=tuple(sweepers))  # type: ignore[arg-type]


def _after(world: World, rows: Rows, place: int, work: Work | None, faults: int = 0) -> World:
    workers = _put(world.workers, place, work)
    return world._replace(rows=rows, workers=workers, faults=world.faults - faults)


def _put(pair: tuple[Any, Any], place: int, one: Any) -> tuple[Any, Any]:
    return (one, pair[1]) if place == 0 else (pair[0], one)


def _claim(session: Session, ids: list[str]) -> tuple[int, int] | None:
    taken = claim(session, "ingest")
    return None if taken is None else (ids.index(taken.job_id), taken.attempt)


def _lose(session: Session, ids: list[str], seen: Silence) -> bool:
    job = Job(id=ids[seen.job], root_id=ids[0], kind="ingest.ok", attempt=seen.attempt, heartbeats=seen.beats)
    return lose_silent(session, job, 20.0)


def _steer(session: Session, ids: list[str], name: str) -> bool:
    try:
        if name == "retry":
            control.retry(session, ids[0], MOST_ATTEMPTS)
        else:
            {"cancel": control.cancel, "terminate": control.terminate}[name](session, ids[0], "as the walk went")
    except JobStateError:
        return False
    return True
