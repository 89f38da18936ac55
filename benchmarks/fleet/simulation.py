"""Workers take jobs off a queue, as the platform has them taken, and everything they share is shared.

**Conventions.** A job is ready when all it needs has ended. Whenever a worker is free it takes the ready job of the
highest priority, of the oldest run, the oldest (`services/runtime/jobs/ready.py`; owners are equal here); with
`order="job"` the oldest job whatever its run. A worker claims by the database, gets from the store, waits, computes
beside the others of its machine, puts to the store, and says by the database that it has ended.
"""

from collections.abc import Generator, Iterable
from dataclasses import dataclass, field
from heapq import heappop, heappush
from typing import Any, Literal

from simpy import Environment, Event, Resource

from benchmarks.fleet.graph import Graph, StageJob
from benchmarks.fleet.sharing import Cores, Line, Shared

Arrival = tuple[float, Graph]
AT_CLAIM = 2.0
"""Transactions before a job begins: its claim, and the note that its run has begun."""


@dataclass(frozen=True)
class Database:
    """`servers` transactions at once, each of `transaction_s`."""

    servers: int = 1
    transaction_s: float = 0.0


@dataclass(frozen=True)
class Fleet:
    """`workers` processes, `per_machine` on each; `dispatch_s` passes from a bell to the job's first line."""

    workers: int
    per_machine: int = 0
    cores: Cores = field(default_factory=Cores)
    dispatch_s: float = 0.0
    database: Database = field(default_factory=Database)
    line: Line = field(default_factory=Line)
    order: Literal["run", "job"] = "run"

    @property
    def on_each(self) -> int:
        """0 said: all on one."""
        return self.per_machine or self.workers


@dataclass
class Course:
    """What happened. `ages_s` is how long each job was ready before it was taken; `ends_s` when each sequence ended.

    `labelled_s` is how long each was there when the last of its usual jobs ended: what is less urgent comes after.
    `spells` are begin, end, what its work would last alone, and urgency, of each job.
    """

    ages_s: list[float] = field(default_factory=list)
    ends_s: list[float] = field(default_factory=list)
    stays_s: list[float] = field(default_factory=list)
    labelled_s: list[float] = field(default_factory=list)
    spells: list[tuple[float, float, float, int]] = field(default_factory=list)
    begun: int = 0
    most_open: int = 0
    busy_s: float = 0.0
    transactions: float = 0.0
    moved_bytes: float = 0.0
    frames: int = 0

    @property
    def lasts_s(self) -> float:
        return max(self.ends_s, default=0.0)


class _Run:
    """A sequence under way."""

    def __init__(self, number: int, came_s: float, graph: Graph) -> None:
        self.number, self.came_s, self.graph = number, came_s, graph
        self.needs_left = [len(job.needs) for job in graph.jobs]
        self.left = len(graph.jobs)
        self.usual_left = sum(job.is_usual for job in graph.jobs)
        self.is_begun = False


class Simulation:
    """`run()` lets all that arrives be worked through."""

    def __init__(self, fleet: Fleet, arrivals: Iterable[Arrival]) -> None:
        self._fleet, self._arrivals = fleet, arrivals
        self._env = Environment()
        self._ready: list[tuple[int, int, int, float, _Run, int]] = []
        self._count = 0
        machines = -(-fleet.workers // fleet.on_each)
        self._machines = [Shared(self._env, fleet.cores.speed) for _ in range(machines)]
        self._idle = [number % machines for number in range(fleet.workers)]
        self._line = Shared(self._env, fleet.line.speed)
        self._database = Resource(self._env, fleet.database.servers)
        self.course = Course()

    def run(self) -> Course:
        self._env.process(self._arrive())
        self._env.run()
        return self.course

    def _arrive(self) -> Generator[Event, Any, None]:
        for number, (at_s, graph) in enumerate(self._arrivals):
            if at_s > self._env.now:
                yield self._env.timeout(at_s - self._env.now)
            run = _Run(number, at_s, graph)
            for place, job in enumerate(graph.jobs):
                if not job.needs:
                    self._offer(run, place)
            self._dispatch()

    def _offer(self, run: _Run, place: int) -> None:
        self._count += 1
        urgency = -run.graph.jobs[place].priority
        age = run.number if self._fleet.order == "run" else 0
        heappush(self._ready, (urgency, age, self._count, self._env.now, run, place))

    def _dispatch(self) -> None:
        while self._idle and self._ready:
            *_, since_s, run, place = heappop(self._ready)
            self.course.ages_s.append(self._env.now - since_s)
            if not run.is_begun:
                run.is_begun = True
                self.course.begun += 1
                self.course.most_open = max(self.course.most_open, self.course.begun - len(self.course.labelled_s))
            self._env.process(self._perform(run, place, self._idle.pop()))

    def _perform(self, run: _Run, place: int, machine: int) -> Generator[Event, Any, None]:
        job, begin_s = run.graph.jobs[place], self._env.now
        if self._fleet.dispatch_s:
            yield self._env.timeout(self._fleet.dispatch_s)
        yield from self._ask(min(job.transactions, AT_CLAIM))
        yield from self._work(job, machine)
        yield from self._ask(max(0.0, job.transactions - AT_CLAIM))
        self._note(job, begin_s)
        self._end(run, place)
        self._idle.append(machine)
        self._dispatch()

    def _work(self, job: StageJob, machine: int) -> Generator[Event, Any, None]:
        if job.get_bytes:
            yield self._line.use(job.get_bytes)
        if job.wait_s:
            yield self._env.timeout(job.wait_s)
        if job.cpu_s:
            yield self._machines[machine].use(job.cpu_s)
        if job.put_bytes:
            yield self._line.use(job.put_bytes)

    def _ask(self, transactions: float) -> Generator[Event, Any, None]:
        lasts_s = transactions * self._fleet.database.transaction_s
        if lasts_s <= 0:
            return
        with self._database.request() as turn:
            yield turn
            yield self._env.timeout(lasts_s)

    def _note(self, job: StageJob, begin_s: float) -> None:
        self.course.busy_s += self._env.now - begin_s
        self.course.spells.append((begin_s, self._env.now, job.lasts_s, job.priority))
        self.course.transactions += job.transactions
        self.course.moved_bytes += job.get_bytes + job.put_bytes

    def _end(self, run: _Run, place: int) -> None:
        run.left -= 1
        if run.graph.jobs[place].is_usual:
            run.usual_left -= 1
            if run.usual_left == 0:
                self.course.labelled_s.append(self._env.now - run.came_s)
        for waiting in run.graph.dependents[place]:
            run.needs_left[waiting] -= 1
            if run.needs_left[waiting] == 0:
                self._offer(run, waiting)
        if run.left == 0:
            self.course.ends_s.append(self._env.now)
            self.course.stays_s.append(self._env.now - run.came_s)
            self.course.frames += run.graph.frames


def simulate(fleet: Fleet, arrivals: Iterable[Arrival]) -> Course:
    """The course of everything that arrives, to its end; arrivals in the order of time."""
    return Simulation(fleet, arrivals).run()
