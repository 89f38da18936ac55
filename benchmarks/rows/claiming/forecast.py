"""The number of workers per database: a discrete-event simulation with the results of `count` and `share`.

**Conventions.** The queue never runs dry. A worker runs its jobs one after the other; each has the length of a measured
job and `visits` transactions, evenly spread. The database has `cores` of its own. Each core serves one transaction
after the other, all with the same processor time; waits for locks and disks are left out. Every lease keeper also sends
presence and its busy workers' heartbeats, at most once every `progress_s`. Workers of a machine have a core each.
"""

import heapq
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

BEATS = ("heartbeat", "log lines")
CLAIMS = ("claim", "end of a job")
PRESENCE = "presence"
LIVENESS = "liveness of a connection"


@dataclass(frozen=True)
class JobDemand:
    """The demand of jobs: transactions per job, heartbeats per busy second, presence per second of a keeper."""

    job_s: tuple[float, ...]
    visits: float
    beats_per_s: float
    presence_per_s: float


@dataclass(frozen=True)
class WorkerFleet:
    """`workers` and their database; `shared` workers have one keeper with a cycle of `turn_s`.

    The database has its cores, and the processor time of a transaction.
    """

    workers: int
    shared: int
    turn_s: float
    cores: int
    transaction_s: float


@dataclass(frozen=True)
class FleetPace:
    """The throughput: jobs per second; shares of the workers' time in jobs, and of the database's."""

    workers: int
    jobs_per_s: float
    busy: float
    database: float


def demand_of(cost: Mapping[str, Any], *, is_shared: bool) -> JobDemand:
    """Return the demand from the JSON of `count`. A connection's liveness check is counted to the following
    transaction.

    Heartbeats are the keeper's if it is shared; otherwise they are counted to the job.
    """
    times, idle, job_s = cost["run"]["transactions"], cost["idle"], cost["job_s"]
    ratio = sum(times.values()) / max(1, sum(times.values()) - times.get(LIVENESS, 0))
    beats = sum(times.get(name, 0) for name in BEATS) * ratio
    visits = sum(count for name, count in times.items() if name not in (*BEATS, PRESENCE, LIVENESS)) * ratio
    presence = sum(idle["transactions"].values()) / idle["lasted_s"] / (1 if is_shared else idle["processes"])
    of_job, of_keeper = (visits, beats) if is_shared else (visits + beats, 0.0)
    return JobDemand(tuple(job_s), of_job / len(job_s), of_keeper / sum(job_s), presence)


def transaction_s(cost: Mapping[str, Any], share: Mapping[str, Any]) -> float:
    """Return PostgreSQL's processor time per transaction, s: the mean of the labelling.

    Claims and ends cost as much as in the claiming processes, if that is more: they are many at once.
    """
    times = cost["run"]["transactions"]
    total, claims = sum(times.values()), sum(times.get(name, 0) for name in CLAIMS)
    of_run = cost["cpu_s_a_job"] * len(cost["job_s"]) / total
    of_claims = max(of_run, share["database_cpu_s"] / share["transactions"])
    return float((claims * of_claims + (total - claims) * of_run) / total)


def pace(demand: JobDemand, fleet: WorkerFleet, lasting_s: float = 60.0, seed: int = 1) -> FleetPace:
    """Return the throughput of the workers within `lasting_s`, after a fifth of it as a start."""
    return _Simulation(demand, fleet, random.Random(seed)).run(lasting_s)


def carried(paces: Sequence[FleetPace]) -> float:
    """Return the best throughput in workers at the pace of the first: the bend of the curve."""
    first = paces[0]
    return max(rate.jobs_per_s for rate in paces) / (first.jobs_per_s / first.workers)


class _Simulation:
    def __init__(self, demand: JobDemand, fleet: WorkerFleet, chance: random.Random) -> None:
        self._demand, self._fleet, self._chance = demand, fleet, chance
        self._free_s = [0.0] * fleet.cores
        self._busy_s = self._worked_s = 0.0
        self._jobs = 0.0
        self._events: list[tuple[float, int, str, int]] = []
        self._number = 0

    def run(self, lasting_s: float) -> FleetPace:
        fleet = self._fleet
        for worker in range(fleet.workers):
            self._at(self._chance.random(), "work", worker)
        for keeper in range(-(-fleet.workers // fleet.shared)):
            if self._demand.beats_per_s > 0:
                self._at(self._chance.random(), "beat", keeper)
            if self._demand.presence_per_s > 0:
                self._at(self._chance.random() / self._demand.presence_per_s, "presence", keeper)
        start_s, end_s = 0.2 * lasting_s, 1.2 * lasting_s
        is_counted = False
        while self._events[0][0] < end_s:
            now_s, _, kind, who = heapq.heappop(self._events)
            if now_s >= start_s and not is_counted:
                is_counted, self._jobs, self._busy_s, self._worked_s = True, 0.0, 0.0, 0.0
            getattr(self, f"_{kind}")(now_s, who)
        shares = (self._worked_s / fleet.workers / lasting_s, min(1.0, self._busy_s / fleet.cores / lasting_s))
        return FleetPace(fleet.workers, self._jobs / lasting_s, *shares)

    def _at(self, at_s: float, kind: str, who: int) -> None:
        self._number += 1
        heapq.heappush(self._events, (at_s, self._number, kind, who))

    def _served(self, now_s: float) -> float:
        """Return the end of a transaction that arrives now, on the core that is free first."""
        done_s = max(self._free_s[0], now_s) + self._fleet.transaction_s
        heapq.heapreplace(self._free_s, done_s)
        self._busy_s += self._fleet.transaction_s
        return done_s

    def _work(self, now_s: float, worker: int) -> None:
        """Run one visit, then the following part of the job."""
        part_s = self._chance.choice(self._demand.job_s) / self._demand.visits
        self._jobs += 1.0 / self._demand.visits
        self._worked_s += part_s
        self._at(self._served(now_s) + part_s, "work", worker)

    def _presence(self, now_s: float, worker: int) -> None:
        self._served(now_s)
        self._at(now_s + 1.0 / self._demand.presence_per_s, "presence", worker)

    def _beat(self, now_s: float, keeper: int) -> None:
        """Send the heartbeats of a keeper's busy workers together, at most once per cycle."""
        self._served(now_s)
        fleet = self._fleet
        members = min(fleet.shared, fleet.workers - keeper * fleet.shared)
        every_s = 1.0 / (members * self._demand.beats_per_s)
        self._at(now_s + (max(every_s, fleet.turn_s) if fleet.shared > 1 else every_s), "beat", keeper)
