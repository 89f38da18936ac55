"""Estimates of the remaining seconds of runs, the same for every page, list, event and command."""

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any, NamedTuple

from sqlalchemy import (
    BigInteger,
    ColumnElement,
    Integer,
    Row,
    ScalarSelect,
    Select,
    String,
    and_,
    case,
    cast,
    exists,
    func,
    literal_column,
    select,
)
from sqlalchemy.orm import Session, aliased
from sqlalchemy.sql.selectable import CTE

from services.domain.benchmarks.submissions.completion_estimate import expected_of
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
    rounded_s,
    seconds_left,
)
from services.domain.sequences.chosen_recordings import recording_ids_of
from services.runtime.database.clock import database_ns
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, parameter, places_for
from services.runtime.jobs.claims import QUEUED, RUNNING, owners_waiting
from services.runtime.jobs.specs import queue_of
from services.runtime.orm import Job, LabelSet, Queue, Recording, SubmissionRow, Worker
from services.runtime.orm.base import now_ns

# The state of the queues: their workers, competing owners, and pauses. Statements are cached; their number grows only
# with the number of queues and urgencies. The query hops along the index from owner to owner, because an owner may have
# hundreds of running jobs.


FRESH_NS = 60 * 10**9


@dataclass(frozen=True)
class QueueFacts:
    """Worker processes by queue, rivals by queue and urgency (owners of no less urgent jobs), and paused queues."""

    workers: Mapping[str, int]
    rivals: Mapping[tuple[str, int], Set[str]]
    paused: frozenset[str]

    def share(self, queue: str, owner_id: str, priority: int) -> float:
        """Return the workers available to a run of this owner: the queue's workers shared with its rivals."""
        others = self.rivals[queue, priority] - {owner_id}
        return max(1, self.workers[queue]) / (1 + len(others))


def queue_facts(session: Session, requested: Iterable[tuple[str, int]]) -> QueueFacts:
    """Return the facts of these queues and urgencies, and all paused queues."""
    wanted = sorted(set(requested))
    queues = sorted({queue for queue, _ in wanted})
    paused = frozenset(row.name for row in _paused().rows(session, {}))
    return QueueFacts(_workers(session, queues), _rivals(session, wanted, queues), paused)


def _workers(session: Session, queues: list[str]) -> dict[str, int]:
    """Return the number of workers per queue with a recent heartbeat."""
    alive = [row.queues.split(",") for row in _select_workers().rows(session, {})]
    return {queue: sum(queue in listened for listened in alive) for queue in queues}


def _rivals(session: Session, wanted: list[tuple[str, int]], queues: list[str]) -> dict[tuple[str, int], Set[str]]:
    """Return, by queue and urgency, the owners with a running or ready job that is equally or more urgent."""
    waiting = {queue: owners_waiting(queue).rows(session, {}) for queue in queues}
    rivals = dict[tuple[str, int], Set[str]]()
    for queue, priority in wanted:
        at_work = _owners_at_work().rows(session, {"queue": queue, "urgency": priority})
        rivals[queue, priority] = {owner for (owner,) in at_work} | {
            owner for owner, urgency, *_ in waiting[queue] if urgency >= priority
        }
    return rivals


@cache
def _select_workers() -> KeptSelect:
    return KeptSelect(select(Worker.queues).where(Worker.beat_ns > database_ns() - FRESH_NS))


@cache
def _paused() -> KeptSelect:
    return KeptSelect(select(Queue.name).where(Queue.mode == "paused"))


@cache
def _owners_at_work() -> KeptSelect:
    """Return the statement of owners with a running job in the queue that is equally or more urgent."""
    owners = select(_next_owner().label("owner_id")).cte("owners", recursive=True)
    owners = owners.union_all(select(_next_owner(owners)).where(owners.c.owner_id.is_not(None)))
    job = aliased(Job)
    of_owner = (*_runs_there(job), job.owner_id == owners.c.owner_id, job.priority >= parameter("urgency", Integer))
    return KeptSelect(select(owners.c.owner_id).where(exists().where(*of_owner)))


def _next_owner(after: CTE | None = None) -> ScalarSelect[str]:
    """Return the first owner with a running job in the queue, or the next owner."""
    job = aliased(Job)
    owner = select(job.owner_id).where(*_runs_there(job)).order_by(job.owner_id).limit(literal_column("1"))
    if after is not None:
        owner = owner.where(job.owner_id > after.c.owner_id).correlate(after)
    return owner.scalar_subquery()


def _runs_there(job: type[Job]) -> tuple[ColumnElement[bool], ...]:
    return job.queue == parameter("queue"), job.state == RUNNING


# Rows of unfinished runs. Statements are cached: a list of fifty runs executes each of them once.


MOST_OLDER = 50
MOST_READ = 1000  # parsed arguments in the cache
COLUMNS = (Job.id, Job.owner_id, Job.kind, Job.queue, Job.priority, cast(Job.arguments, String))
IS_ALIVE_RUN = (Job.id == Job.root_id, Job.state.in_([QUEUED, RUNNING]))


class RunInputs(NamedTuple):
    """The inputs of a labelling run: recordings, calibration, and whether it ends with labels."""

    recording_ids: tuple[str, ...]
    makes_labels: bool


class AliveRow(NamedTuple):
    """An unfinished run; only a labelling run has `inputs`."""

    id: str
    owner_id: str
    kind: str
    queue: str
    priority: int
    inputs: RunInputs | None


def alive_rows(session: Session, job_ids: Sequence[str]) -> list[AliveRow]:
    """Return the jobs that are unfinished runs."""
    session.flush()  # cached statements see only flushed rows
    rows = _of_ids(places_for(len(job_ids))).rows(session, numbered(job_ids)) if job_ids else ()
    return [_alive_row(row) for row in rows]


def older_of_the_same(session: Session, runs: Iterable[AliveRow]) -> list[AliveRow]:
    """Return unfinished labelling runs that the same owners requested earlier; these run first."""
    owners = sorted({run.owner_id for run in runs})
    if not owners:
        return []
    newest = max(run.id for run in runs)
    older = _older(places_for(len(owners))).rows(session, {**numbered(owners), "newest": newest})
    return [_alive_row(row) for row in older]


@cache
def _of_ids(places: int) -> KeptSelect:
    return KeptSelect(_alive().where(Job.id.in_(numbered_parameters(places))))


@cache
def _older(places: int) -> KeptSelect:
    mine = (Job.owner_id.in_(numbered_parameters(places)), Job.kind == LABELLING, Job.id < parameter("newest"))
    return KeptSelect(_alive().where(*mine).order_by(Job.id.desc()).limit(literal_column(str(MOST_OLDER))))


def _alive() -> Select[*tuple[Any, ...]]:
    return select(*COLUMNS).where(*IS_ALIVE_RUN)


def _alive_row(row: Row[*tuple[Any, ...]]) -> AliveRow:
    id, owner_id, kind, queue, priority, arguments = row
    return AliveRow(id, owner_id, kind, queue, priority, _inputs(arguments) if kind == LABELLING else None)


@lru_cache(MOST_READ)
def _inputs(arguments: str) -> RunInputs:
    read = json.loads(arguments)
    return RunInputs(recording_ids_of(read), "label" in read.get("stages", ["label"]))


# The work and workers of unfinished runs, read for many at once. The number of statements grows with the number of
# queues, not runs. Times of jobs refer to their last attempt. A job that is its own run is a run with one stage.


class AliveRun(NamedTuple):
    """A run, its work and the queue in which it mostly waits; `is_paused` if none of its jobs may start."""

    run: AliveRow
    work: RunWorkload
    queue: str
    is_paused: bool


class RunStages(NamedTuple):
    """The stages of a run in the order of their first jobs, and the frames after synchronisation, if known."""

    stages: tuple[StageWork, ...] = ()
    frames: int | None = None


NOT_BEGUN = RunStages()


def alive_runs(session: Session, runs: Sequence[AliveRow], at_ns: int) -> list[AliveRun]:
    """Return the state of the runs at `at_ns`."""
    stages = stages_of(session, [run.id for run in runs], at_ns)
    queues = {run.id: _queue_of(run, stages.get(run.id, NOT_BEGUN).stages) for run in runs}
    facts = queue_facts(session, [(queues[run.id], run.priority) for run in runs])
    share = cache(facts.share)  # shared by many runs of a list
    workers = {run.id: share(queues[run.id], run.owner_id, run.priority) for run in runs}
    works = _workloads(session, runs, stages, workers)
    return [
        AliveRun(run, work, queue, _waits_for(work, queue, facts.paused))
        for run, work, queue in zip(runs, works, queues.values(), strict=True)
    ]


def _waits_for(work: RunWorkload, queue: str, paused: Set[str]) -> bool:
    """Return whether the run has jobs left in one of these queues."""
    return bool(paused) and bool(paused & ({queue_of(stage.kind) for stage in work.stages if stage.left} or {queue}))


def stages_of(session: Session, root_ids: Sequence[str], at_ns: int) -> Mapping[str, RunStages]:
    """Return the stages of each run that has jobs."""
    rows = _counts(places_for(len(root_ids))).rows(session, numbered(root_ids))
    running = _running_jobs(session, list(dict.fromkeys(row[0] for row in rows if row[2])), at_ns)
    stages, frames = defaultdict[str, list[StageWork]](list), dict[str, int]()
    for root_id, kind, _, queued, done, busy_ns, frame_count in rows:
        at_it = tuple(running.get((root_id, kind), ()))
        stages[root_id].append(StageWork(kind, int(queued), at_it, int(done), int(busy_ns or 0) / 1e9))
        if frame_count:
            frames[root_id] = int(float(frame_count))
    return {root_id: RunStages(tuple(stages_of_run), frames.get(root_id)) for root_id, stages_of_run in stages.items()}


def _running_jobs(session: Session, root_ids: Sequence[str], at_ns: int) -> dict[tuple[str, str], list[RunningJob]]:
    """Return the running jobs by run and kind."""
    running = defaultdict[tuple[str, str], list[RunningJob]](list)
    rows = _at_work(places_for(len(root_ids))).rows(session, numbered(root_ids)) if root_ids else ()
    for root_id, kind, started_ns, done, total in rows:
        elapsed_s = max(0, at_ns - (started_ns or at_ns)) / 1e9
        running[root_id, kind].append(RunningJob(elapsed_s, done / total if kind in SHARES and total else None))
    return running


@cache
def _counts(places: int) -> KeptSelect:
    """Return the statement that counts jobs by kind and synchronised frames for these run ids."""

    def counted(state: str) -> ColumnElement[int]:
        return func.sum(case((Job.state == state, 1), else_=0))

    busy = cast(func.sum(case((Job.state == "succeeded", BUSY), else_=0)), BigInteger)
    synchronised = and_(Job.kind == SYNCHRONISE, Job.state == "succeeded")
    frames = func.max(case((synchronised, Job.result["frames"].as_string())))
    columns = (*(counted(state) for state in ("running", "queued", "succeeded")), busy, frames)
    of_runs = (Job.root_id.in_(numbered_parameters(places)), Job.queue != "")
    grouped = select(Job.root_id, Job.kind, *columns).where(*of_runs).group_by(Job.root_id, Job.kind)
    return KeptSelect(grouped.order_by(func.min(Job.id)))


@cache
def _at_work(places: int) -> KeptSelect:
    """Return the statement of running jobs for these run ids."""
    at_work = select(Job.root_id, Job.kind, Job.started_ns, Job.done, Job.total).where(Job.state == RUNNING)
    return KeptSelect(at_work.where(Job.root_id.in_(numbered_parameters(places)), Job.queue != ""))


def _workloads(
    session: Session, runs: Sequence[AliveRow], stages_by_run: Mapping[str, RunStages], workers: Mapping[str, float]
) -> list[RunWorkload]:
    """Return the workload of each run."""
    inputs = [run.inputs for run in runs if run.inputs]
    lengths = _recorded_s(
        session, sorted({recording_id for made_of in inputs for recording_id in made_of.recording_ids})
    )

    def workload(run: AliveRow) -> RunWorkload:
        stages, frames = stages_by_run.get(run.id, NOT_BEGUN)
        if run.inputs is None:
            return RunWorkload(run.kind, stages, workers=workers[run.id])
        recording_ids, makes_labels = run.inputs
        recorded_s = sum(lengths.get(recording_id, 0.0) for recording_id in recording_ids) or None
        return RunWorkload(run.kind, stages, recorded_s, frames, makes_labels, workers[run.id])

    return [workload(run) for run in runs]


def _recorded_s(session: Session, recording_ids: Sequence[str]) -> dict[str, float]:
    rows = _lengths(places_for(len(recording_ids))).rows(session, numbered(recording_ids)) if recording_ids else ()
    return {recording_id: float(lasted_ns) / 1e9 for recording_id, lasted_ns in rows if lasted_ns}


@cache
def _lengths(places: int) -> KeptSelect:
    lengths = select(Recording.id, Recording.inspection["duration_ns"].as_string())
    return KeptSelect(lengths.where(Recording.id.in_(numbered_parameters(places))))


def _queue_of(run: AliveRow, stages: Sequence[StageWork]) -> str:
    """Return the queue that determines the run's duration: for a labelling run the labeler's."""
    if run.queue or run.kind == LABELLING:
        return run.queue or queue_of(FUSE)
    left = [stage for stage in stages if stage.left]
    return queue_of(left[-1].kind) if left else ""


SCORE = "score"
IMPORT, SCENE = "dataset.import", "labeler.import_scene"


def time_left(session: Session, job_ids: Sequence[str]) -> Mapping[str, int]:
    """Return the remaining seconds, rounded up, by id of the unfinished runs that have an estimate.

    Jobs within a run have no estimate of their own. A run has none while a queue that it needs is paused, and a
    labelling run has none until its first job is done.
    """
    runs = alive_rows(session, job_ids)
    if not runs:
        return {}
    scores = [run for run in runs if run.kind == SCORE]
    return {
        **_other_estimates(session, [run for run in runs if run.kind != SCORE]),
        **_score_estimates(session, scores),
    }


def _other_estimates(session: Session, runs: list[AliveRow]) -> dict[str, int]:
    if not runs:
        return {}
    run_ids = {run.id for run in runs}
    before = [run for run in older_of_the_same(session, runs) if run.id not in run_ids]
    alive = alive_runs(session, [*runs, *before], now_ns())
    paces = {kind: pace_of(session, kind) for kind in {alive_run.run.kind for alive_run in alive}}
    left = {
        alive_run.run.id: None if _is_unknown(alive_run) else seconds_left(alive_run.work, paces[alive_run.run.kind])
        for alive_run in alive
    }
    ahead_s = _ahead_s(alive, left)
    based = run_ids - {alive_run.run.id for alive_run in alive if _is_without_basis(alive_run)}
    known = {run_id: own_s for run_id, own_s in left.items() if own_s is not None and run_id in based}
    return {run_id: rounded_s(own_s + ahead_s[run_id]) for run_id, own_s in known.items()}


def _ahead_s(alive: Sequence[AliveRun], left: Mapping[str, float | None]) -> dict[str, float]:
    """Return, by run, the seconds that older runs of the same owner in its queue take; their jobs run first."""
    sums, ahead_s = defaultdict[tuple[str, str, int], float](float), dict[str, float]()
    for run in sorted(alive, key=lambda run: run.run.id):
        same = (run.queue, run.run.owner_id, run.run.priority)
        ahead_s[run.run.id] = sums[same]
        sums[same] += left[run.run.id] or 0.0
    return ahead_s


def _is_unknown(alive: AliveRun) -> bool:
    """Return whether no estimate is possible: a queue is paused, or an import has not listed its scenes yet."""
    scenes = any(stage.kind == SCENE for stage in alive.work.stages)
    return alive.is_paused or (alive.run.kind == IMPORT and not scenes)


def _is_without_basis(alive: AliveRun) -> bool:
    """Return whether this is a labelling run without a finished job; other recordings may differ tenfold."""
    return alive.run.kind == LABELLING and not any(stage.done for stage in alive.work.stages)


def _score_estimates(session: Session, runs: list[AliveRow]) -> dict[str, int]:
    """Return the estimates shown on the submissions' pages."""
    if not runs:
        return {}
    scored = select(SubmissionRow).where(SubmissionRow.job_id.in_([run.id for run in runs]))
    return expected_of(session, session.scalars(scored).all())


# Durations of the jobs of the last successful runs of a kind. Times of jobs refer to their last attempt. Statements are
# cached.


RECENT_RUNS = 3
LOOKED_AT = 20
BUSY = func.coalesce(Job.finished_ns - Job.started_ns, 0)


def pace_of(session: Session, kind: str) -> Pace:
    """Return the durations of jobs in the last successful runs of this kind."""
    root_ids = [row.id for row in _newest().rows(session, {"kind": kind})]
    jobs = _took().rows(session, numbered(root_ids)) if root_ids else ()
    rows = [row for row in jobs if row[2]]
    counts, busy_s = defaultdict[str, int](int), defaultdict[str, float](float)
    for _, stage, count, busy_ns in rows:
        counts[stage] += int(count)
        busy_s[stage] += int(busy_ns) / 1e9
    seconds = {stage: busy_s[stage] / counts[stage] for stage in counts}
    if kind == LABELLING:
        per_run_s = {root_id: int(busy_ns) / 1e9 for root_id, stage, _, busy_ns in rows if stage == SYNCHRONISE}
        seconds = {stage: took_s for stage, took_s in seconds.items() if stage != SYNCHRONISE}
        seconds |= _pace_of_synchronisation(session, per_run_s)
    tiles = counts[SURFACE] / counts[FUSE] if counts[FUSE] else None
    return Pace(seconds, tiles)


def _pace_of_synchronisation(session: Session, busy_s: Mapping[str, float]) -> dict[str, float]:
    """Return seconds per recorded second, from runs whose labels have the recorded duration."""
    rows = _lasted().rows(session, numbered(list(busy_s))) if busy_s else ()
    lasted_s = {row.job_id: row.duration_ns / 1e9 for row in rows if row.duration_ns}
    if not lasted_s:
        return {}
    return {SYNCHRONISE: sum(busy_s[job_id] for job_id in lasted_s) / sum(lasted_s.values())}


@cache
def _newest() -> KeptSelect:
    """Return the statement of a kind's most recently started successful runs."""
    newest = select(Job.id, Job.state).where(Job.id == Job.root_id, Job.kind == parameter("kind"))
    looked_at = newest.order_by(Job.id.desc()).limit(literal_column(str(LOOKED_AT))).subquery()
    ended = select(looked_at.c.id).where(looked_at.c.state == "succeeded").order_by(looked_at.c.id.desc())
    return KeptSelect(ended.limit(literal_column(str(RECENT_RUNS))))


@cache
def _took() -> KeptSelect:
    """Return the statement that sums number and duration of succeeded jobs, by run and kind.

    The state is not in the condition: SQLite would then read all jobs that ever succeeded.
    """
    ended = and_(Job.state == "succeeded", Job.finished_ns.is_not(None))
    counted = (func.sum(case((ended, 1), else_=0)), cast(func.sum(case((ended, BUSY), else_=0)), BigInteger))
    of_runs = (Job.root_id.in_(numbered_parameters(RECENT_RUNS)), Job.queue != "")
    return KeptSelect(select(Job.root_id, Job.kind, *counted).where(*of_runs).group_by(Job.root_id, Job.kind))


@cache
def _lasted() -> KeptSelect:
    of_runs = LabelSet.job_id.in_(numbered_parameters(RECENT_RUNS))
    return KeptSelect(select(LabelSet.job_id, LabelSet.duration_ns).where(of_runs))
