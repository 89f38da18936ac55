"""How the queues stand in which runs wait: who works there, who else waits, and which of them are paused.

**Conventions.** Statements are kept; their number grows with that of the queues only.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, places_for
from services.runtime.jobs.readiness import RUNNING, owners_waiting
from services.runtime.orm import Job, Queue, Worker

FRESH_NS = 60 * 10**9


@dataclass(frozen=True)
class QueueFacts:
    """Of each queue the number of worker processes, and of each owner at work there their most urgent job; `paused`."""

    workers: Mapping[str, int]
    rivals: Mapping[str, Mapping[str, int]]
    paused: frozenset[str]

    def share(self, queue: str, owner_id: str, priority: int) -> float:
        """The workers that a run of this owner can have: the queue's are shared with who is no less urgent."""
        others = sum(owner != owner_id and urgency >= priority for owner, urgency in self.rivals[queue].items())
        return max(1, self.workers[queue]) / (1 + others)


def queue_facts(session: Session, queues: Iterable[str]) -> QueueFacts:
    """Of these queues; of paused ones all."""
    named = sorted(set(queues))
    paused = frozenset(row.name for row in _paused().rows(session, {}))
    return QueueFacts(_workers(session, named), _rivals(session, named), paused)


def _workers(session: Session, queues: list[str]) -> dict[str, int]:
    """The worker processes that were heard of late and listen to each queue."""
    heard = [row.queues.split(",") for row in _heard().rows(session, {})]
    return {queue: sum(queue in listened for listened in heard) for queue in queues}


def _rivals(session: Session, queues: list[str]) -> dict[str, dict[str, int]]:
    """By queue, the owners who have a job there that runs or may run, and how urgent their most urgent one is."""
    rivals = defaultdict[str, dict[str, int]](dict)
    found = list[tuple[str, str, int]](_at_work(places_for(len(queues))).rows(session, numbered(queues)))
    for queue in queues:
        found += [(queue, owner, urgency) for owner, urgency, *_ in owners_waiting(queue).rows(session, {})]
    for queue, owner, urgency in found:
        rivals[queue][owner] = max(urgency, rivals[queue].get(owner, urgency))
    return {queue: rivals[queue] for queue in queues}


@cache
def _heard() -> KeptSelect:
    return KeptSelect(select(Worker.queues).where(Worker.beat_ns > database_ns() - FRESH_NS))


@cache
def _paused() -> KeptSelect:
    return KeptSelect(select(Queue.name).where(Queue.mode == "paused"))


@cache
def _at_work(places: int) -> KeptSelect:
    """By queue and owner, how urgent the most urgent of their jobs is that run."""
    at_work = select(Job.queue, Job.owner_id, func.max(Job.priority)).where(Job.state == RUNNING)
    of_queues = at_work.where(Job.queue.in_(numbered_parameters(places)))
    return KeptSelect(of_queues.group_by(Job.queue, Job.owner_id))
