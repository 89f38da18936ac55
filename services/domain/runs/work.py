"""What alive runs have to do, what such runs took before, and how many workers they can have: read for many at once.

**Conventions.** The number of statements does not grow with the number of runs, only with that of their kinds and
queues. Times of jobs are those of their last attempt. A job that is its own run is a run of one stage.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

from sqlalchemy import BigInteger, ColumnElement, case, cast, func, literal_column, select
from sqlalchemy.orm import Session

from services.domain.runs.time_left import (
    FUSE,
    LABELLING,
    SHARES,
    SURFACE,
    SYNCHRONISE,
    Pace,
    RunningJob,
    RunWorkload,
    StageWork,
)
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.runtime.database.clock import database_ns
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, places_for
from services.runtime.jobs.readiness import owners_waiting
from services.runtime.jobs.specs import queue_of
from services.runtime.orm import CalibrationRow, Job, LabelSet, Queue, Recording, Worker

RECENT_RUNS = 3
LOOKED_AT = 20
MOST_OLDER = 50
FRESH_NS = 60 * 10**9
BUSY = func.coalesce(Job.finished_ns - Job.started_ns, 0)
RUNNING: ColumnElement[str] = literal_column("'running'")


@dataclass(frozen=True)
class AliveRun:
    """A run, its work and the queue in which it waits most; `is_paused` where no job of it may start."""

    run: Job
    work: RunWorkload
    queue: str
    is_paused: bool


def alive_runs(session: Session, runs: Sequence[Job], at_ns: int) -> list[AliveRun]:
    """The runs as they stand at `at_ns`."""
    stages = stages_of(session, [run.id for run in runs], at_ns)
    facts = _facts_of_labellings(session, [run for run in runs if run.kind == LABELLING])
    queues = {run.id: _queue_of(run, stages.get(run.id, ())) for run in runs}
    workers = _workers(session, set(queues.values()))
    rivals = _rivals(session, set(queues.values()))
    paused = set(session.scalars(select(Queue.name).where(Queue.mode == "paused")))
    alive = []
    for run in runs:
        queue = queues[run.id]
        others = sum(owner != run.owner_id and urgency >= run.priority for owner, urgency in rivals[queue].items())
        known = facts.get(run.id, RunWorkload(run.kind, ()))
        work = replace(known, stages=stages.get(run.id, ()), workers=max(1, workers[queue]) / (1 + others))
        left = {queue_of(stage.kind) for stage in work.stages if stage.left} or {queue}
        alive.append(AliveRun(run, work, queue, bool(left & paused)))
    return alive


def stages_of(session: Session, root_ids: Iterable[str], at_ns: int) -> Mapping[str, tuple[StageWork, ...]]:
    """The stages of each run in the order in which their first jobs were made."""
    ids = list(root_ids)
    counts, at_work = _stage_statements(places_for(len(ids)))
    running = defaultdict[tuple[str, str], list[RunningJob]](list)
    for root_id, kind, started_ns, *progress in at_work.rows(session, numbered(ids)):
        done, total = progress
        elapsed_s = max(0, at_ns - (started_ns or at_ns)) / 1e9
        share = done / total if kind in SHARES and total else None
        running[root_id, kind].append(RunningJob(elapsed_s, share))
    found = defaultdict[str, list[StageWork]](list)
    for root_id, kind, *sums in counts.rows(session, numbered(ids)):
        queued, done, busy_ns = sums
        at_it = tuple(running[root_id, kind])
        found[root_id].append(StageWork(kind, int(queued), at_it, int(done), int(busy_ns or 0) / 1e9))
    return {root_id: tuple(stages) for root_id, stages in found.items()}


@cache
def _stage_statements(places: int) -> tuple[KeptSelect, KeptSelect]:
    """Of runs by their ids: jobs by kind, counted, and those that run."""

    def counted(state: str) -> ColumnElement[int]:
        return func.sum(case((Job.state == state, 1), else_=0))

    busy = cast(func.sum(case((Job.state == "succeeded", BUSY), else_=0)), BigInteger)
    of_runs = (Job.root_id.in_(numbered_parameters(places)), Job.queue != "")
    columns = (Job.root_id, Job.kind, counted("queued"), counted("succeeded"), busy)
    grouped = select(*columns).where(*of_runs).group_by(Job.root_id, Job.kind).order_by(func.min(Job.id))
    at_work = select(Job.root_id, Job.kind, Job.started_ns, Job.done, Job.total).where(*of_runs, Job.state == RUNNING)
    return KeptSelect(grouped), KeptSelect(at_work)


def pace_of(session: Session, kind: str) -> Pace:
    """What jobs took in the last runs of this kind that succeeded."""
    newest = select(Job.id, Job.state).where(Job.id == Job.root_id, Job.kind == kind)
    looked_at = newest.order_by(Job.id.desc()).limit(LOOKED_AT).subquery()
    ended = select(looked_at.c.id).where(looked_at.c.state == "succeeded").order_by(looked_at.c.id.desc())
    root_ids = list(session.scalars(ended.limit(RECENT_RUNS)))
    of_runs = (Job.root_id.in_(root_ids), Job.queue != "", Job.state == "succeeded", Job.finished_ns.is_not(None))
    took = select(Job.root_id, Job.kind, func.count(), cast(func.sum(BUSY), BigInteger)).where(*of_runs)
    rows = session.execute(took.group_by(Job.root_id, Job.kind)).all() if root_ids else []
    counts, busy_s = defaultdict[str, int](int), defaultdict[str, float](float)
    for _, stage, count, busy_ns in rows:
        counts[stage] += count
        busy_s[stage] += int(busy_ns) / 1e9
    seconds = {stage: busy_s[stage] / counts[stage] for stage in counts}
    if kind == LABELLING:
        per_run_s = {root_id: int(busy_ns) / 1e9 for root_id, stage, _, busy_ns in rows if stage == SYNCHRONISE}
        seconds = {stage: took_s for stage, took_s in seconds.items() if stage != SYNCHRONISE}
        seconds |= _pace_of_synchronisation(session, per_run_s)
    tiles = counts[SURFACE] / counts[FUSE] if counts[FUSE] else None
    return Pace(seconds, tiles)


def _pace_of_synchronisation(session: Session, busy_s: Mapping[str, float]) -> dict[str, float]:
    """Seconds per recorded second, of the runs whose labels tell how long they were recorded."""
    lasted = select(LabelSet.job_id, LabelSet.duration_ns).where(LabelSet.job_id.in_(list(busy_s)))
    lasted_s = {job_id: ns / 1e9 for job_id, ns in session.execute(lasted) if ns} if busy_s else {}
    if not lasted_s:
        return {}
    return {SYNCHRONISE: sum(busy_s[job_id] for job_id in lasted_s) / sum(lasted_s.values())}


def _facts_of_labellings(session: Session, runs: Sequence[Job]) -> dict[str, RunWorkload]:
    """What is known of each labelling besides its jobs."""
    recordings = {run.id: recording_ids_of(run.arguments) for run in runs}
    lengths = _recorded_s(session, {one for ids in recordings.values() for one in ids})
    cameras = _cameras(session, {str(run.arguments.get("calibration_id")) for run in runs})
    frames = _frames(session, [run.id for run in runs])
    return {
        run.id: RunWorkload(
            run.kind,
            (),
            recorded_s=sum(lengths.get(one, 0.0) for one in recordings[run.id]) or None,
            frames=frames.get(run.id),
            cameras=cameras.get(str(run.arguments.get("calibration_id")), 0),
            makes_labels="label" in run.arguments.get("stages", ["label"]),
        )
        for run in runs
    }


def _recorded_s(session: Session, recording_ids: set[str]) -> dict[str, float]:
    if not recording_ids:
        return {}
    told = select(Recording.id, Recording.inspection["duration_ns"].as_string()).where(Recording.id.in_(recording_ids))
    return {recording_id: float(lasted_ns) / 1e9 for recording_id, lasted_ns in session.execute(told) if lasted_ns}


def _cameras(session: Session, calibration_ids: set[str]) -> dict[str, int]:
    if not calibration_ids:
        return {}
    told = select(CalibrationRow.id, CalibrationRow.sensors).where(CalibrationRow.id.in_(calibration_ids))
    return {one: sum(sensor.get("kind") == "camera" for sensor in sensors) for one, sensors in session.execute(told)}


def _frames(session: Session, root_ids: list[str]) -> dict[str, int]:
    """The frames that synchronisation found, of the runs that are through with it."""
    if not root_ids:
        return {}
    told = select(Job.root_id, Job.result["frames"].as_string()).where(
        Job.root_id.in_(root_ids), Job.kind == SYNCHRONISE, Job.state == "succeeded"
    )
    return {root_id: int(float(frames)) for root_id, frames in session.execute(told) if frames}


def _queue_of(run: Job, stages: Sequence[StageWork]) -> str:
    """The queue whose workers decide how long it takes: of a labelling the labeler's."""
    if run.queue or run.kind == LABELLING:
        return run.queue or queue_of(FUSE)
    left = [stage for stage in stages if stage.left]
    return queue_of(left[-1].kind) if left else ""


def _workers(session: Session, queues: set[str]) -> dict[str, int]:
    """The worker processes that were heard of late and listen to each queue."""
    heard = session.scalars(select(Worker.queues).where(Worker.beat_ns > database_ns() - FRESH_NS)).all()
    return {queue: sum(queue in listened.split(",") for listened in heard) for queue in queues}


def _rivals(session: Session, queues: set[str]) -> dict[str, dict[str, int]]:
    """By queue, the owners who have a job there that runs or may run, and how urgent their most urgent one is."""
    rivals = defaultdict[str, dict[str, int]](dict)
    at_work = select(Job.queue, Job.owner_id, func.max(Job.priority)).where(Job.state == RUNNING)
    found = [
        (queue, owner, urgency) for queue, owner, urgency in session.execute(at_work.group_by(Job.queue, Job.owner_id))
    ]
    for queue in queues:
        found += [(queue, owner, urgency) for owner, urgency, *_ in owners_waiting(queue).rows(session, {})]
    for queue, owner, urgency in found:
        rivals[queue][owner] = max(urgency, rivals[queue].get(owner, urgency))
    return rivals


def older_of_the_same(session: Session, runs: Iterable[Job]) -> list[Job]:
    """Alive labellings that the same owners asked for before the newest of these, which are done first."""
    owners = {run.owner_id for run in runs}
    if not owners:
        return []
    mine = (
        Job.owner_id.in_(owners),
        Job.state.in_(("queued", "running")),
        Job.kind == LABELLING,
        Job.id == Job.root_id,
    )
    older = select(Job).where(*mine, Job.id < max(run.id for run in runs)).order_by(Job.id.desc())
    return list(session.scalars(older.limit(MOST_OLDER)))
