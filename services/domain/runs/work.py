"""What alive runs have to do, and how many workers they can have: read for many at once.

**Conventions.** The number of statements does not grow with the number of runs, only with that of their queues. Times
of jobs are those of their last attempt. A job that is its own run is a run of one stage.
"""

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence, Set
from functools import cache
from typing import NamedTuple

from sqlalchemy import BigInteger, ColumnElement, String, and_, case, cast, func, select
from sqlalchemy.orm import Session

from services.domain.runs.paces import BUSY
from services.domain.runs.queue_facts import queue_facts
from services.domain.runs.run_rows import AliveRow
from services.domain.runs.time_left import FUSE, LABELLING, SHARES, SYNCHRONISE, RunningJob, RunWorkload, StageWork
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, places_for
from services.runtime.jobs.claims import RUNNING
from services.runtime.jobs.specs import queue_of
from services.runtime.orm import CalibrationRow, Job, Recording


class AliveRun(NamedTuple):
    """A run, its work and the queue in which it waits most; `is_paused` where no job of it may start."""

    run: AliveRow
    work: RunWorkload
    queue: str
    is_paused: bool


class RunStages(NamedTuple):
    """The stages of a run in the order in which their first jobs were made, and the frames that it found, if it did."""

    stages: tuple[StageWork, ...] = ()
    frames: int | None = None


NOT_BEGUN = RunStages()


def alive_runs(session: Session, runs: Sequence[AliveRow], at_ns: int) -> list[AliveRun]:
    """The runs as they stand at `at_ns`."""
    found = stages_of(session, [run.id for run in runs], at_ns)
    queues = {run.id: _queue_of(run, found.get(run.id, NOT_BEGUN).stages) for run in runs}
    facts = queue_facts(session, [(queues[run.id], run.priority) for run in runs])
    share = cache(facts.share)  # which many runs of a list have in common
    workers = {run.id: share(queues[run.id], run.owner_id, run.priority) for run in runs}
    works = _workloads(session, runs, found, workers)
    return [
        AliveRun(run, work, queue, _waits_for(work, queue, facts.paused))
        for run, work, queue in zip(runs, works, queues.values(), strict=True)
    ]


def _waits_for(work: RunWorkload, queue: str, paused: Set[str]) -> bool:
    """Whether one of these queues is among those in which it has jobs left."""
    return bool(paused) and bool(paused & ({queue_of(stage.kind) for stage in work.stages if stage.left} or {queue}))


def stages_of(session: Session, root_ids: Sequence[str], at_ns: int) -> Mapping[str, RunStages]:
    """The stages of each run that has jobs."""
    rows = _counts(places_for(len(root_ids))).rows(session, numbered(root_ids))
    running = _running_jobs(session, list(dict.fromkeys(row[0] for row in rows if row[2])), at_ns)
    stages, frames = defaultdict[str, list[StageWork]](list), dict[str, int]()
    for root_id, kind, _, queued, done, busy_ns, told in rows:
        at_it = tuple(running.get((root_id, kind), ()))
        stages[root_id].append(StageWork(kind, int(queued), at_it, int(done), int(busy_ns or 0) / 1e9))
        if told:
            frames[root_id] = int(float(told))
    return {root_id: RunStages(tuple(found), frames.get(root_id)) for root_id, found in stages.items()}


def _running_jobs(session: Session, root_ids: Sequence[str], at_ns: int) -> dict[tuple[str, str], list[RunningJob]]:
    """By run and kind, of the runs that have some."""
    running = defaultdict[tuple[str, str], list[RunningJob]](list)
    rows = _at_work(places_for(len(root_ids))).rows(session, numbered(root_ids)) if root_ids else ()
    for root_id, kind, started_ns, done, total in rows:
        elapsed_s = max(0, at_ns - (started_ns or at_ns)) / 1e9
        running[root_id, kind].append(RunningJob(elapsed_s, done / total if kind in SHARES and total else None))
    return running


@cache
def _counts(places: int) -> KeptSelect:
    """Of runs by their ids: jobs by kind, counted, with the frames that synchronisation found."""

    def counted(state: str) -> ColumnElement[int]:
        return func.sum(case((Job.state == state, 1), else_=0))

    busy = cast(func.sum(case((Job.state == "succeeded", BUSY), else_=0)), BigInteger)
    found = and_(Job.kind == SYNCHRONISE, Job.state == "succeeded")
    frames = func.max(case((found, Job.result["frames"].as_string())))
    columns = (*(counted(state) for state in ("running", "queued", "succeeded")), busy, frames)
    of_runs = (Job.root_id.in_(numbered_parameters(places)), Job.queue != "")
    grouped = select(Job.root_id, Job.kind, *columns).where(*of_runs).group_by(Job.root_id, Job.kind)
    return KeptSelect(grouped.order_by(func.min(Job.id)))


@cache
def _at_work(places: int) -> KeptSelect:
    """Of runs by their ids: the jobs that run."""
    at_work = select(Job.root_id, Job.kind, Job.started_ns, Job.done, Job.total).where(Job.state == RUNNING)
    return KeptSelect(at_work.where(Job.root_id.in_(numbered_parameters(places)), Job.queue != ""))


def _workloads(
    session: Session, runs: Sequence[AliveRow], found: Mapping[str, RunStages], workers: Mapping[str, float]
) -> list[RunWorkload]:
    """What each has to do."""
    inputs = [run.inputs for run in runs if run.inputs]
    lengths = _recorded_s(session, sorted({one for made_of in inputs for one in made_of.recording_ids}))
    cameras = _cameras(session, sorted({one.calibration_id for one in inputs if one.calibration_id}))

    def workload(run: AliveRow) -> RunWorkload:
        stages, frames = found.get(run.id, NOT_BEGUN)
        if run.inputs is None:
            return RunWorkload(run.kind, stages, workers=workers[run.id])
        recording_ids, calibration_id, makes_labels = run.inputs
        recorded_s = sum(lengths.get(one, 0.0) for one in recording_ids) or None
        seen_by = cameras.get(calibration_id or "", 0)
        return RunWorkload(run.kind, stages, recorded_s, frames, seen_by, makes_labels, workers[run.id])

    return [workload(run) for run in runs]


def _recorded_s(session: Session, recording_ids: Sequence[str]) -> dict[str, float]:
    rows = _lengths(places_for(len(recording_ids))).rows(session, numbered(recording_ids)) if recording_ids else ()
    return {recording_id: float(lasted_ns) / 1e9 for recording_id, lasted_ns in rows if lasted_ns}


@cache
def _lengths(places: int) -> KeptSelect:
    told = select(Recording.id, Recording.inspection["duration_ns"].as_string())
    return KeptSelect(told.where(Recording.id.in_(numbered_parameters(places))))


def _cameras(session: Session, calibration_ids: Sequence[str]) -> dict[str, int]:
    rows = (
        _sensors(places_for(len(calibration_ids))).rows(session, numbered(calibration_ids)) if calibration_ids else ()
    )
    return {one: sum(sensor.get("kind") == "camera" for sensor in json.loads(sensors)) for one, sensors in rows}


@cache
def _sensors(places: int) -> KeptSelect:
    told = select(CalibrationRow.id, cast(CalibrationRow.sensors, String))
    return KeptSelect(told.where(CalibrationRow.id.in_(numbered_parameters(places))))


def _queue_of(run: AliveRow, stages: Sequence[StageWork]) -> str:
    """The queue whose workers decide how long it takes: of a labelling the labeler's."""
    if run.queue or run.kind == LABELLING:
        return run.queue or queue_of(FUSE)
    left = [stage for stage in stages if stage.left]
    return queue_of(left[-1].kind) if left else ""
