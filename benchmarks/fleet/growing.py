"""More and more workers: how many sequences an hour, how long jobs wait, and what bends first.

**Conventions.** A backlog is worked through, and what is less urgent comes last, when nothing else is left. So the time
that a sequence costs is the sum of what it costs in each of these parts, taken in each from 20 to 80 % of its work: a
queue that fills or runs dry counts for nothing. The ages of the queue are taken with arrivals by chance (Poisson) at
four fifths of that pace.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from random import Random

import numpy as np

from benchmarks.fleet.graph import Graph
from benchmarks.fleet.simulation import Arrival, Course, Fleet, simulate

SHARE = 0.8
EDGE = 0.2


@dataclass(frozen=True)
class Step:
    """What so many workers do; ratios are of what is to be had.

    p50 and p95 at four fifths of the pace: `ages_s` of jobs, `labelled_s` of sequences until their labels are there.
    """

    workers: int
    sequences: int
    sequences_per_h: float
    frames_per_s: float
    efficiency: float
    ages_s: tuple[float, float]
    labelled_s: tuple[float, float]
    most_open: int
    transactions_per_s: float
    bytes_per_s: float
    database_ratio: float
    line_ratio: float

    def million_days(self) -> float:
        """How long a million sequences take at this pace."""
        return 1e6 / self.sequences_per_h / 24


def grown(graph: Graph, fleet: Fleet, counts: Sequence[int], each: int = 4) -> Iterator[Step]:
    """One step for each number of workers, `each` sequences for every worker, at least 60."""
    for workers in counts:
        yield step(graph, replace(fleet, workers=workers), max(60, each * workers))


def step(graph: Graph, fleet: Fleet, sequences: int) -> Step:
    """A backlog of so many sequences, then as many by chance."""
    full = simulate(fleet, [(0.0, graph)] * sequences)
    rate_hz = pace_hz(full)
    usual = simulate(fleet, by_chance(graph, SHARE * rate_hz, sequences))
    asked = sum(job.transactions for job in graph.jobs)
    moved = sum(job.get_bytes + job.put_bytes for job in graph.jobs)
    capacity = fleet.database.servers / fleet.database.transaction_s if fleet.database.transaction_s else float("inf")
    return Step(
        workers=fleet.workers,
        sequences=sequences,
        sequences_per_h=rate_hz * 3600,
        frames_per_s=rate_hz * graph.frames,
        efficiency=rate_hz * graph.work_s / fleet.workers,
        ages_s=_spread(usual.ages_s),
        labelled_s=_spread(usual.labelled_s),
        most_open=full.most_open,
        transactions_per_s=rate_hz * asked,
        bytes_per_s=rate_hz * moved,
        database_ratio=rate_hz * asked / capacity,
        line_ratio=rate_hz * moved / fleet.line.all_bytes_per_s,
    )


def pace_hz(course: Course) -> float:
    """Sequences a second; a job's work is spread evenly over the time it took."""
    spells, total_s = np.array(course.spells), 0.0
    for urgency in np.unique(spells[:, 3]):
        begins, ends, works, _ = spells[spells[:, 3] == urgency].T
        ends = np.maximum(ends, begins + 1e-9)
        rates, at_s = works / (ends - begins), np.concatenate([begins, ends])
        order = np.argsort(at_s)
        at_s, rate = at_s[order], np.cumsum(np.concatenate([rates, -rates])[order])
        done = np.concatenate([[0.0], np.cumsum(rate[:-1] * np.diff(at_s))])
        first_s, last_s = np.interp([EDGE * done[-1], (1 - EDGE) * done[-1]], done, at_s)
        total_s += (last_s - first_s) / (1 - 2 * EDGE)
    return float(len(course.ends_s) / total_s)


def by_chance(graph: Graph, rate_hz: float, count: int, seed: int = 1) -> Iterator[Arrival]:
    chance, at_s = Random(seed), 0.0
    for _ in range(count):
        at_s += chance.expovariate(rate_hz)
        yield at_s, graph


def _spread(values_s: Sequence[float]) -> tuple[float, float]:
    p50, p95 = np.percentile(values_s, (50, 95))
    return float(p50), float(p95)
