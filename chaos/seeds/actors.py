"""The actors of a history: workers, sweepers, an owner, an administrator and the nemesis.

**Conventions.** Each actor is a task without end; its pauses and next actions are drawn. An `OutageError` ends an
actor's current action, as it would end a request or a task. Any other exception of the platform ends the history.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import cast

from sqlalchemy import select
from sqlalchemy.orm import Session

from chaos.seeds.faulty_database import OWNER, OutageError
from chaos.seeds.scheduler import Process
from chaos.seeds.world import QUEUES, World
from services.runtime.jobs import control
from services.runtime.jobs.enqueue import enqueue, enqueue_run
from services.runtime.jobs.errors import JobStateError, QueueDrainingError
from services.runtime.jobs.execution import Reporter, run_row
from services.runtime.jobs.lease_sweep import (
    CRASHED,
    STOPPED,
    WORKER_STOPPED,
    Sweeper,
    give_back_of,
    give_back_running,
)
from services.runtime.jobs.specs import Attempt, Context, JobSpec, Outcome
from services.runtime.orm import FigureRow, Job
from stone.errors import Refused

WORKERS, SWEEPERS = 3, 2
MOST_RUNS, MOST_JOBS = 4, 16
AWAITED = ("labeler.step",)
REFUSED = "odd"
STUMBLED = "Input/output error"


class Handling:
    """The handlers of a worker: they report, sleep, fail and add more jobs at random.

    `effects` counts the commits of successes in the database.
    """

    def __init__(self, world: World) -> None:
        self._world, self._dice = world, world.dice

    def __call__(self, attempt: Attempt) -> Outcome:
        reporter, dice = cast("Reporter", attempt), self._dice
        self._world.scheduler.current.process.attempt = reporter.last_words().key
        for done in range(dice.randrange(4)):
            attempt.progress("at work", done, 3)
            if dice.random() < 0.5:
                attempt.log("at work", done=done)
            self._world.scheduler.pause(dice.choice((0.0, 0.2, 2.0, 9.0, 30.0)))
        self._fail()
        then = self._then(attempt)
        return Outcome({"then": len(then)}, then, lambda session: _count(session, attempt.job_id))

    def _fail(self) -> None:
        drawn = self._dice.random() if not self._world.is_calm else 1.0
        if drawn < 0.04:
            raise Refused(REFUSED, "drawn from the seed")
        if drawn < 0.12:
            raise OSError(5, STUMBLED)
        if drawn < 0.13:
            self._world.scheduler.pause(2 * self._world.platform.settings.jobs.time_limit_s)

    def _then(self, attempt: Attempt) -> tuple[JobSpec, ...]:
        if attempt.job_id == attempt.root_id or self._world.is_calm or self._dice.random() < 0.7:
            return ()
        arguments = {"by": attempt.job_id}
        after = AWAITED if self._dice.random() < 0.5 and self._has_awaited(attempt.root_id) else ()
        return JobSpec("ingest.step", arguments, "x"), JobSpec("labeler.step", arguments, needs=("x",), after=after)

    def _has_awaited(self, root_id: str) -> bool:
        """Return whether the run has a job of the kinds in `AWAITED`; a handler may name no other kind in `after`."""
        with self._world.database.looking_on() as session:
            kinds = session.scalars(select(Job.kind).where(Job.root_id == root_id)).all()
        return not set(AWAITED).isdisjoint(kinds)


def _count(session: Session, job_id: str) -> None:
    row = session.get(FigureRow, job_id) or FigureRow(name=job_id, value=0, measured_ns=1)
    row.value += 1
    session.add(row)


def begin(world: World) -> None:
    """Start all actors."""
    world.wanted = world.dice.randrange(1, WORKERS + 1)
    _spawn(world, "supervisor", lambda: supervise(world))
    for number in range(world.dice.randrange(1, SWEEPERS + 1)):
        _spawn(world, f"sweeper {number}", lambda: sweep(world))
    _spawn(world, "owner", lambda: own(world))
    _spawn(world, "nemesis", lambda: harm(world))


def _spawn(world: World, name: str, work: Callable[[], None]) -> None:
    world.scheduler.spawn(Process(name), name, work)


def supervise(world: World) -> None:
    """Replace each worker that has ended."""
    while True:
        while len(_alive(world)) < world.wanted:
            add_worker(world)
        world.scheduler.pause(1.0)


def add_worker(world: World) -> None:
    """Start a process that runs one job row for each wake-up."""
    process = Process(f"worker:{len(world.workers)}")
    world.workers.append(process)
    step = Handling(world)
    handlers = {f"{queue}.step": step for queue in QUEUES}

    def work() -> None:
        while True:
            queue = world.broker.receive()
            with suppress(OutageError):
                run_row(world.platform, queue, handlers, lambda: world.dice.random() < 0.6)

    world.scheduler.spawn(process, process.name, work)


def sweep(world: World) -> None:
    """Run a sweeper every few seconds."""
    sweeper = Sweeper(world.platform, world.broker.waiting, world.broker.send, lambda: world.scheduler.now_s)
    while True:
        world.scheduler.pause(world.dice.choice((1.0, 2.0, 5.0)))
        with suppress(OutageError):
            sweeper.sweep()


def own(world: World) -> None:
    """Queue, stop and retry runs, as an owner does."""
    while True:
        act = world.dice.choice((queue_run, queue_run, stop_run, stop_run, try_again, try_again))
        with suppress(OutageError, JobStateError, QueueDrainingError):
            act(world)
        world.scheduler.pause(world.dice.choice((0.0, 0.5, 3.0, 10.0)))


def queue_run(world: World) -> None:
    if len(world.runs) >= MOST_RUNS or world.is_calm:
        return
    dice = world.dice
    context = Context(OWNER, priority=dice.randrange(2))
    specs = [
        JobSpec(f"{dice.choice(QUEUES)}.step", key=str(n), needs=tuple(str(m) for m in range(n) if dice.random() < 0.4))
        for n in range(dice.randrange(6))
    ]
    with world.database.transaction() as session:
        if specs:
            run = enqueue_run(session, "sequence.process", specs, context)
        else:
            run = enqueue(session, JobSpec("ingest.step"), context)
        world.runs.append(run.id)  # if the answer is lost, the run may exist or not


def stop_run(world: World) -> None:
    if not world.runs or world.is_calm:
        return
    run_id = world.dice.choice(world.runs)
    act = control.terminate if world.dice.random() < 0.3 else control.cancel
    if not _exists(world, run_id):
        return
    with world.database.transaction() as session:
        act(session, run_id, "drawn from the seed")
    world.requests_of(run_id).stopped = True


def try_again(world: World) -> None:
    if not world.runs or world.is_calm:
        return
    run_id = world.dice.choice(world.runs)
    if not _exists(world, run_id):
        return
    requests = world.requests_of(run_id)
    with world.database.transaction() as session:
        control.retry(session, run_id, world.platform.settings.jobs.max_attempts)
        requests.retries, requests.stopped = requests.retries + 1, False  # before the answer, which may be lost


def _exists(world: World, run_id: str) -> bool:
    with world.database.looking_on() as session:
        return session.get(Job, run_id) is not None


def harm(world: World) -> None:
    """Kill, stop and hold processes, the broker and the database, and turn queues off (the nemesis)."""
    acts = (kill, kill, hold, hold, stop_worker, restart_platform, lose_broker, lose_database, turn)
    while True:
        world.scheduler.pause(world.dice.choice((1.0, 4.0, 15.0)))
        if not world.is_calm:
            with suppress(OutageError):
                world.dice.choice(acts)(world)


def _alive(world: World) -> list[Process]:
    return [process for process in world.workers if not process.is_dead]


def kill(world: World) -> None:
    """Kill a worker, as kill −9 does."""
    if alive := _alive(world):
        world.scheduler.kill(world.dice.choice(alive))


def hold(world: World) -> None:
    """Stop a worker, and continue it before or after its lease ends (SIGSTOP, SIGCONT)."""
    if alive := _alive(world):
        world.dice.choice(alive).held_until_s = world.scheduler.now_s + world.dice.choice((1.0, 15.0, 30.0, 60.0))


def stop_worker(world: World) -> None:
    """Stop a worker in an orderly way; its parent returns the child's jobs."""
    if alive := _alive(world):
        process = world.dice.choice(alive)
        world.scheduler.kill(process)
        give_back_of(world.platform, [process.name], WORKER_STOPPED)


def restart_platform(world: World) -> None:
    """End all workers, orderly or not, and return their jobs before new workers start."""
    wanted, world.wanted = world.wanted, 0
    for process in _alive(world):
        world.scheduler.kill(process)
    is_crash = world.dice.random() < 0.5
    try:
        give_back_running(world.platform, CRASHED if is_crash else STOPPED, is_counted=is_crash)
    finally:
        world.wanted = wanted


def lose_broker(world: World) -> None:
    if world.dice.random() < 0.5:
        world.broker.forget()
    world.broker.away_until_s = world.scheduler.now_s + world.dice.choice((0.0, 2.0, 30.0))


def lose_database(world: World) -> None:
    world.database.away_until_s = world.scheduler.now_s + world.dice.choice((0.5, 5.0, 30.0))


def turn(world: World) -> None:
    """Pause, drain or open a queue, as an administrator does."""
    with world.database.transaction() as session:
        control.set_mode(session, world.dice.choice(QUEUES), world.dice.choice(("open", "paused", "draining")))
