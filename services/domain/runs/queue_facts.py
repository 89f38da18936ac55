"""How the queues stand in which runs wait: who works there, who else waits, and which of them are paused.

**Conventions.** Statements are kept; their number grows with that of the queues and urgencies only. Owners at work are
hopped to one after another down the index, each looked at until one of their jobs is urgent enough: they may have
hundreds of jobs at work.
"""

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass
from functools import cache

from sqlalchemy import ColumnElement, Integer, ScalarSelect, exists, literal_column, select
from sqlalchemy.orm import Session, aliased
from sqlalchemy.sql.selectable import CTE

from services.runtime.database.clock import database_ns
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.jobs.claims import RUNNING, owners_waiting
from services.runtime.orm import Job, Queue, Worker

FRESH_NS = 60 * 10**9


@dataclass(frozen=True)
class QueueFacts:
    """Of each queue the number of worker processes, and with each urgency the owners who are no less urgent there."""

    workers: Mapping[str, int]
    rivals: Mapping[tuple[str, int], Set[str]]
    paused: frozenset[str]

    def share(self, queue: str, owner_id: str, priority: int) -> float:
        """The workers that a run of this owner can have: the queue's are shared with who is no less urgent."""
        others = self.rivals[queue, priority] - {owner_id}
        return max(1, self.workers[queue]) / (1 + len(others))


def queue_facts(session: Session, asked: Iterable[tuple[str, int]]) -> QueueFacts:
    """Of these queues, with these urgencies; of paused ones all."""
    wanted = sorted(set(asked))
    queues = sorted({queue for queue, _ in wanted})
    paused = frozenset(row.name for row in _paused().rows(session, {}))
    return QueueFacts(_workers(session, queues), _rivals(session, wanted, queues), paused)


def _workers(session: Session, queues: list[str]) -> dict[str, int]:
    """The worker processes that were heard of late and listen to each queue."""
    heard = [row.queues.split(",") for row in _heard().rows(session, {})]
    return {queue: sum(queue in listened for listened in heard) for queue in queues}


def _rivals(session: Session, wanted: list[tuple[str, int]], queues: list[str]) -> dict[tuple[str, int], Set[str]]:
    """By queue and urgency, the owners with a job there that is no less urgent, and runs or may run."""
    waiting = {queue: owners_waiting(queue).rows(session, {}) for queue in queues}
    rivals = dict[tuple[str, int], Set[str]]()
    for queue, priority in wanted:
        at_work = _owners_at_work().rows(session, {"queue": queue, "urgency": priority})
        rivals[queue, priority] = {owner for (owner,) in at_work} | {
            owner for owner, urgency, *_ in waiting[queue] if urgency >= priority
        }
    return rivals


@cache
def _heard() -> KeptSelect:
    return KeptSelect(select(Worker.queues).where(Worker.beat_ns > database_ns() - FRESH_NS))


@cache
def _paused() -> KeptSelect:
    return KeptSelect(select(Queue.name).where(Queue.mode == "paused"))


@cache
def _owners_at_work() -> KeptSelect:
    """The owners with a job that runs in the queue and is no less urgent."""
    owners = select(_next_owner().label("owner_id")).cte("owners", recursive=True)
    owners = owners.union_all(select(_next_owner(owners)).where(owners.c.owner_id.is_not(None)))
    job = aliased(Job)
    of_owner = (*_runs_there(job), job.owner_id == owners.c.owner_id, job.priority >= parameter("urgency", Integer))
    return KeptSelect(select(owners.c.owner_id).where(exists().where(*of_owner)))


def _next_owner(after: CTE | None = None) -> ScalarSelect[str]:
    """The first owner with a job that runs in the queue, or the first who follows."""
    job = aliased(Job)
    found = select(job.owner_id).where(*_runs_there(job)).order_by(job.owner_id).limit(literal_column("1"))
    if after is not None:
        found = found.where(job.owner_id > after.c.owner_id).correlate(after)
    return found.scalar_subquery()


def _runs_there(job: type[Job]) -> tuple[ColumnElement[bool], ...]:
    return job.queue == parameter("queue"), job.state == RUNNING
