"""A run here, foretold: how long one sequence takes with more workers, by the times of the run with one.

**Conventions.** Nothing of the run that is foretold goes into its forecast but its number of workers and how many cores
others took meanwhile, which on an idle machine is next to nothing. How much slower jobs are beside each other
(`contention`) is measured by itself: strangers' runs, as many at once as there are cores, against one alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from benchmarks.fleet.measuring import Measured
from benchmarks.fleet.sharing import Cores
from benchmarks.fleet.simulation import Fleet, simulate

WITHIN = 0.15


@dataclass(frozen=True)
class Forecast:
    """What was foretold and what was measured, by the clock."""

    workers: int
    measured_s: float
    predicted_s: float
    taken: float

    @property
    def error(self) -> float:
        """Of the measured, positive where the forecast was too long."""
        return self.predicted_s / self.measured_s - 1.0

    @property
    def is_within(self) -> bool:
        return abs(self.error) <= WITHIN


def contention_of(alone: Sequence[Measured], together: Sequence[Measured]) -> float:
    """How many times the processor time of one alone a run takes while every core is busy; at least 1."""
    return max(1.0, median(run.cpu_s for run in together) / median(run.cpu_s for run in alone))


def forecast(base: Measured, contention: float, run: Measured) -> Forecast:
    """`base` is the run with one worker that all is foretold by."""
    return Forecast(run.workers, run.wall_s, predicted_s(base, contention, run), run.taken)


def predicted_s(base: Measured, contention: float, run: Measured) -> float:
    """How long the sequence of `base` takes with the workers of `run`, on what others left of the cores then."""
    cores = Cores(run.cores, contention, run.taken)
    fleet = Fleet(run.workers, cores=cores, dispatch_s=base.dispatch_s)
    return simulate(fleet, [(0.0, base.graph())]).lasts_s


def middle(runs: Sequence[Measured]) -> Measured:
    """The run with the median wall clock; of an even number the quicker of the two."""
    ordered = sorted(runs, key=lambda run: run.wall_s)
    return ordered[(len(ordered) - 1) // 2]
