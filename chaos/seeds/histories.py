"""Play the history of a seed: `CHAOS_STEPS` steps of chaos, then calm until every run has ended, and judge it."""

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from unittest import mock

import structlog
from sqlalchemy import text
from sqlalchemy.orm import Session

from chaos.seeds.actors import begin
from chaos.seeds.faulty_database import clear
from chaos.seeds.scheduler import Process, virtual
from chaos.seeds.verdict import Rows, judge_end, judge_step
from chaos.seeds.world import QUEUES, World
from services.runtime.jobs import lease_sweep
from services.runtime.jobs.control import set_mode
from services.runtime.orm import Job

CHAOS_STEPS = 300
LOOKS_EACH = 64
PATIENCE_S = 1500.0
"""Every run ends within this time of calm; a lease is a hundredth of it."""
LEFT = text("SELECT 1 FROM jobs WHERE state IN ('queued', 'running') LIMIT 1")


class ViolationError(Exception):
    """A rule of `chaos.seeds.verdict` was violated."""


@dataclass(frozen=True)
class History:
    """The result of a seed: its steps (transactions), its checksum, and its violation (empty if there was none)."""

    seed: int
    steps: int
    trace: int
    violation: str = ""


def play(seed: int, looks_each: int = LOOKS_EACH) -> History:
    """Play the seed and judge it; the rows are judged every `looks_each` turns."""
    clear()
    world = World(seed)
    violation = ""
    with ExitStack() as stack:
        stack.enter_context(_silent())
        stack.enter_context(virtual(world.scheduler))
        stack.enter_context(_hearing(world))
        stack.callback(world.database.close)
        stack.callback(world.scheduler.close)
        try:
            _go(world, looks_each)
        except Exception as error:
            violation = f"{type(error).__name__}: {error}" if not isinstance(error, ViolationError) else str(error)
    return History(seed, world.database.transactions, world.scheduler.trace, violation)


def _go(world: World, looks_each: int) -> None:
    begin(world)
    world.scheduler.run(lambda: _judged(world, looks_each) and world.database.transactions < CHAOS_STEPS)
    world.calm()
    until_s = world.scheduler.now_s + PATIENCE_S
    world.scheduler.spawn(Process("opening"), "opening", lambda: _open_queues(world))
    world.scheduler.run(lambda: _judged(world, looks_each) and world.scheduler.now_s < until_s and not _is_over(world))
    with world.database.looking_on() as session:
        rows = Rows.of(session)
    for sentence in judge_end(world, rows, world.platform.settings.jobs.max_attempts):
        raise ViolationError(sentence)


def _open_queues(world: World) -> None:
    for queue in QUEUES:
        with world.database.transaction() as session:
            set_mode(session, queue, "open")


def _judged(world: World, looks_each: int) -> bool:
    """Return True, or raise `ViolationError`."""
    if world.scheduler.turns % looks_each == 0:
        with world.database.looking_on() as session:
            for sentence in judge_step(Rows.of(session)):
                raise ViolationError(sentence)
    return True


def _is_over(world: World) -> bool:
    if world.scheduler.turns % 16:
        return False
    with world.database.looking_on() as session:
        return session.execute(LEFT).first() is None


@contextmanager
def _hearing(world: World) -> Iterator[None]:
    """Raise a violation inside this context if an attempt is ended as silent within its lease after a heartbeat."""
    lose_silent = lease_sweep.lose_silent

    def heard(session: Session, seen: Job, lease_s: float) -> bool:
        is_lost = lose_silent(session, seen, lease_s)
        since_s = world.scheduler.now_s - world.database.heard.get((seen.id, seen.attempt), -1e9)
        if is_lost and since_s < lease_s:
            raise ViolationError(f"lost: job {seen.id} sent a heartbeat {since_s:.1f} s ago, and was ended as silent")
        return is_lost

    with mock.patch.object(lease_sweep, "lose_silent", heard):
        yield


@contextmanager
def _silent() -> Iterator[None]:
    """Switch logging off inside this context, since the faults are drawn."""
    config = structlog.get_config()
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    try:
        yield
    finally:
        structlog.configure(**config)
