"""The jobs of one sequence: what each costs and what it waits for.

**Conventions.** A job's `needs` are places of jobs before it in the tuple. `cpu_s` is processor time on a core of its
own; `wait_s` is what passes besides, waiting for disks and answers, whoever else uses the processors. `transactions`,
`get_bytes` and `put_bytes` are what it asks of database and store (`benchmarks/job_costs.py`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any


@dataclass(frozen=True)
class StageJob:
    """One job; `priority` higher first."""

    kind: str
    cpu_s: float
    wait_s: float = 0.0
    needs: tuple[int, ...] = ()
    priority: int = 0
    transactions: float = 0.0
    get_bytes: float = 0.0
    put_bytes: float = 0.0

    @property
    def lasts_s(self) -> float:
        """Alone on its machine."""
        return self.cpu_s + self.wait_s

    @property
    def is_usual(self) -> bool:
        """Not of those that come when nothing else waits."""
        return self.priority >= 0


@dataclass(frozen=True)
class Graph:
    """The jobs of one sequence, and how many frames they label. Raises `ValueError` where one needs a later one."""

    jobs: tuple[StageJob, ...]
    frames: int = 0

    def __post_init__(self) -> None:
        for place, job in enumerate(self.jobs):
            if any(not 0 <= need < place for need in job.needs):
                raise ValueError(f"job {place} ({job.kind}) needs {job.needs}; only jobs before it can be needed")

    @property
    def cpu_s(self) -> float:
        return sum(job.cpu_s for job in self.jobs)

    @property
    def work_s(self) -> float:
        """How long one worker takes."""
        return sum(job.lasts_s for job in self.jobs)

    @cached_property
    def critical_s(self) -> float:
        """The longest chain of needs: no number of workers is quicker. 0 without jobs."""
        ends: list[float] = []
        for job in self.jobs:
            ends.append(max((ends[need] for need in job.needs), default=0.0) + job.lasts_s)
        return max(ends, default=0.0)

    @cached_property
    def dependents(self) -> tuple[tuple[int, ...], ...]:
        """Of each job those that wait for it."""
        waiting: list[list[int]] = [[] for _ in self.jobs]
        for place, job in enumerate(self.jobs):
            for need in job.needs:
                waiting[need].append(place)
        return tuple(map(tuple, waiting))

    def asking(self, costs: Mapping[str, Mapping[str, float]]) -> "Graph":
        """The same jobs with what each kind asks of database and store; of unknown kinds nothing."""
        return replace(self, jobs=tuple(_asking(job, costs.get(job.kind, {})) for job in self.jobs))


def _asking(job: StageJob, costs: Mapping[str, float]) -> StageJob:
    transactions, get, put = (costs.get(name, 0.0) for name in ("transactions", "get_bytes", "put_bytes"))
    return replace(job, transactions=transactions, get_bytes=get, put_bytes=put)


def load_graph(record: Mapping[str, Any]) -> Graph:
    """The graph that `dataclasses.asdict` made a record of."""
    jobs = (StageJob(**{**job, "needs": tuple(job["needs"])}) for job in record["jobs"])
    return Graph(tuple(jobs), record["frames"])
