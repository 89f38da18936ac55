"""Estimate of a run's remaining time, from the durations of its own jobs and of similar earlier jobs.

**Conventions.** The stages of a run are done in layers, one after the other. With `W` workers a layer takes

    max(Σ seconds of its jobs / W, its longest job)   to   Σ seconds of its jobs / W + (1 − 1/W) · its longest job,

the bounds of list scheduling (Graham, Bounds on Multiprocessing Timing Anomalies, 1969); the estimate is the middle. A
job of a kind takes `c = (w·s·p + Σ busy) / (w + done)`: `w = JOB_WEIGHT` earlier jobs (`p`, from the platform's last
runs, else `TYPICAL`) and the run's own finished jobs. `s = Σ busy / Σ p` over the run's finished jobs scales for a
slower machine or a denser LiDAR; it is 1 while none is finished. Tiles of the surface differ a hundredfold, and the
first tiles are the margin of the map. They therefore take `N·s·p` together, whatever the first tiles took, and do not
contribute to `s`. Times are in seconds. This module uses no clock and no database: replay calibrates the estimate
(`python -m benchmarks.time_left`).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from math import ceil
from typing import NamedTuple

LABELLING = "sequence.process"
SYNCHRONISE, CHECK, PARTS = "ingest.synchronise", "ingest.check", "labeler.parts"
FUSE, SURFACE, REFERENCE, FRAMES = "labeler.fuse", "labeler.surface", "labeler.reference", "labeler.frames"
MAP, PICTURES, PUBLISH = "labeler.map", "labeler.pictures", "labeler.publish"
LAYERS = ((SYNCHRONISE,), (PARTS,), (CHECK, FUSE, SURFACE), (REFERENCE,), (FRAMES, MAP, PICTURES), (PUBLISH,))
"""Layers of a labelling run. Any other run has its own kinds of jobs, one after the other."""
OF_LABELLING = frozenset(kind for layer in LAYERS for kind in layer)
SHARES = (FUSE, FRAMES, "labeler.export")
"""Kinds whose progress counts frames of similar duration."""
UNEVEN = (SURFACE,)
LEAST_UNEVEN = 0.25
LEAST_SHARE = 0.1
SHARE_WEIGHT = 0.6
JOB_WEIGHT = 3.0
OVERDUE = 0.5
"""An overdue job is expected to take this share of its elapsed time more."""
FRAMES_HZ = 10.0
FRAMES_PER_PART = 60
MOST_PLANS = 1000  # cached plans of labelling runs, by their number of parts
UNKNOWN_LENGTH_S = 60.0
"""Assumed length of recordings registered by versions that did not store it."""

TYPICAL: Mapping[str, float] = {
    SYNCHRONISE: 0.2,
    CHECK: 1.0,
    PARTS: 0.1,
    FUSE: 1.0,
    SURFACE: 1.0,
    REFERENCE: 0.1,
    FRAMES: 1.5,
    MAP: 1.1,
    PICTURES: 1.2,
    PUBLISH: 0.3,
}
"""Typical seconds of a job by kind, before the platform's first run; for synchronisation per recorded second."""
TYPICAL_TILES = 1.8


class RunningJob(NamedTuple):
    """A running job: elapsed seconds, and its finished share if its units are frames, else None."""

    elapsed_s: float
    share: float | None = None


class StageWork(NamedTuple):
    """The jobs of one kind of a run; `busy_s` is the total duration of the `done` jobs."""

    kind: str
    queued: int = 0
    running: tuple[RunningJob, ...] = ()
    done: int = 0
    busy_s: float = 0.0

    @property
    def left(self) -> int:
        return self.queued + len(self.running)


NOTHING = StageWork("")


class RunWorkload(NamedTuple):
    """The state of a run: its `kind` and its stages in the order of their first jobs.

    - `recorded_s`: length of its recordings, None if unknown
    - `frames`: frames after synchronisation, None if unknown
    - `makes_labels`: if False, the run ends with synchronisation
    - `workers`: number of available workers
    """

    kind: str
    stages: tuple[StageWork, ...]
    recorded_s: float | None = None
    frames: int | None = None
    makes_labels: bool = True
    workers: float = 1.0

    @property
    def length_s(self) -> float:
        return UNKNOWN_LENGTH_S if self.recorded_s is None else self.recorded_s


@dataclass(frozen=True)
class Pace:
    """Seconds of jobs in the last runs of the kind, by kind; for synchronisation per recorded second."""

    seconds: Mapping[str, float] = field(default_factory=dict)
    tiles_per_part: float | None = None

    @cached_property
    def expected_s(self) -> Mapping[str, float]:
        """Seconds by kind, with typical values for kinds without earlier jobs."""
        return {**TYPICAL, **self.seconds}

    @property
    def tiles(self) -> float:
        return TYPICAL_TILES if self.tiles_per_part is None else self.tiles_per_part


def seconds_left(work: RunWorkload, pace: Pace) -> float | None:
    """Return the seconds until the run ends; None if the duration of its jobs is unknown."""
    stages = {stage.kind: stage for stage in (*work.stages, *_to_come(work, pace))}
    expected_s = _expected_s(work, pace)
    scale = _scale(work, expected_s)
    left_s = 0.0
    for layer in _layers(work):
        sum_s = longest_s = 0.0
        for kind in layer:
            stage = stages.get(kind, NOTHING)
            if not (stage.queued or stage.running):
                continue
            own_s = _job_s(stage, work, expected_s.get(kind), scale)
            if own_s is None:
                return None
            stage_s, longest_of_stage_s = _stage_s(stage, own_s)
            sum_s += stage_s
            longest_s = max(longest_s, longest_of_stage_s)
        if longest_s:
            left_s += _layer_s(sum_s, longest_s, work.workers)
    return left_s


def _layer_s(sum_s: float, longest_s: float, workers: float) -> float:
    """Return the middle of the bounds of list scheduling."""
    mean_s, others = sum_s / workers, 1 - 1 / workers if workers > 1 else 0.0
    return (max(mean_s, longest_s) + mean_s + others * longest_s) / 2


def _layers(work: RunWorkload) -> Iterable[tuple[str, ...]]:
    """Yield groups of kinds that run at the same time, one group after the other."""
    if work.kind != LABELLING:
        return [(stage.kind,) for stage in work.stages]
    others = [(stage.kind,) for stage in work.stages if stage.kind not in OF_LABELLING]
    return (*LAYERS, *others) if others else LAYERS


def rounded_s(seconds: float) -> int:
    """Round up to a sensible step: 1 s up to 15 s, 5 s up to a minute, 10 s up to 5 min, then 1 and 5 min."""
    step = next((step for limit, step in ((15, 1), (60, 5), (300, 10), (3600, 60)) if seconds <= limit), 300)
    return max(1, ceil(seconds / step) * step)


def _to_come(work: RunWorkload, pace: Pace) -> Iterable[StageWork]:
    """Return the stages of a labelling run that are not queued yet, because earlier stages determine them."""
    known = [stage.kind for stage in work.stages]
    if work.kind != LABELLING or FUSE in known or not known:
        return ()
    if not work.makes_labels:
        return () if CHECK in known else (StageWork(CHECK, queued=1),)
    frames = work.frames if work.frames is not None else FRAMES_HZ * work.length_s
    parts = max(1, ceil(frames / FRAMES_PER_PART))
    tiles = max(1, round(parts * pace.tiles))
    return [stage for stage in _of_labelling(parts, tiles) if stage.kind not in known]


@lru_cache(MOST_PLANS)
def _of_labelling(parts: int, tiles: int) -> tuple[StageWork, ...]:
    """Return the stages after synchronisation, before their start."""
    counts = {CHECK: 1, PARTS: 1, FUSE: parts, SURFACE: tiles, REFERENCE: 1, FRAMES: parts}
    counts |= {MAP: 1, PICTURES: 1, PUBLISH: 1}
    return tuple(StageWork(kind, queued=count) for kind, count in counts.items() if count)


def _expected_s(work: RunWorkload, pace: Pace) -> Mapping[str, float]:
    """Return the expected seconds of a job by kind; for synchronisation with the length of these recordings."""
    return {**pace.expected_s, SYNCHRONISE: pace.expected_s[SYNCHRONISE] * work.length_s}


def _scale(work: RunWorkload, expected_s: Mapping[str, float]) -> float:
    """Return the ratio of this run's job durations to the expected durations; 1 while no job is done."""
    busy_s = before_s = 0.0
    for stage in work.stages:
        if stage.kind in expected_s and stage.kind not in UNEVEN:
            busy_s += stage.busy_s
            before_s += expected_s[stage.kind] * stage.done
    return busy_s / before_s if busy_s and before_s else 1.0


def _job_s(stage: StageWork, work: RunWorkload, before_s: float | None, scale: float) -> float | None:
    """Return the seconds of a job of the stage; None if neither this run nor an earlier run has a duration."""
    if before_s is not None:
        if stage.kind in UNEVEN:
            return scale * before_s
        return (JOB_WEIGHT * scale * before_s + stage.busy_s) / (JOB_WEIGHT + stage.done)
    if stage.done:
        return stage.busy_s / stage.done
    done = sum(other.done for other in work.stages)
    if done:
        return sum(other.busy_s for other in work.stages) / done
    shares = [job for job in stage.running if job.share and job.share >= LEAST_SHARE and stage.kind in SHARES]
    return max(job.elapsed_s / (job.share or 1.0) for job in shares) if shares else None


def _stage_s(stage: StageWork, own_s: float) -> tuple[float, float]:
    """Return the total seconds of the running and waiting jobs, and the seconds of the longest."""
    queued_s, longest_s = (_queued_s(stage, own_s), own_s) if stage.queued else (0.0, 0.0)
    if not stage.running:
        return queued_s, longest_s
    running_s = [_running_s(stage.kind, job, own_s) for job in stage.running]
    return queued_s + sum(running_s), max(longest_s, *running_s)


def _queued_s(stage: StageWork, own_s: float) -> float:
    """Return the seconds of the waiting jobs; for uneven jobs the remainder of the stage's expected sum."""
    if stage.kind not in UNEVEN:
        return stage.queued * own_s
    others_s = stage.busy_s + sum(max(own_s, job.elapsed_s) for job in stage.running)
    rest_s = own_s * (stage.done + stage.left) - others_s
    return max(LEAST_UNEVEN * own_s * stage.queued, rest_s)


def _running_s(kind: str, job: RunningJob, own_s: float) -> float:
    """Return the remaining seconds of a running job; frame progress, if counted, has weight `SHARE_WEIGHT`."""
    usual_s = max(own_s - job.elapsed_s, OVERDUE * job.elapsed_s)
    if kind not in SHARES or job.share is None or job.share < LEAST_SHARE:
        return usual_s
    by_share_s = job.elapsed_s * (1 - min(1.0, job.share)) / job.share
    return (1 - SHARE_WEIGHT) * usual_s + SHARE_WEIGHT * by_share_s
