"""What the jobs of a kind of run took in the last of them that succeeded.

**Conventions.** Times of jobs are those of their last attempt. Statements are kept.
"""

from collections import defaultdict
from collections.abc import Mapping
from functools import cache

from sqlalchemy import BigInteger, and_, case, cast, func, literal_column, select
from sqlalchemy.orm import Session

from services.domain.runs.time_left import FUSE, LABELLING, SURFACE, SYNCHRONISE, Pace
from services.runtime.database.rows import KeptSelect, numbered, numbered_parameters, parameter
from services.runtime.orm import Job, LabelSet

RECENT_RUNS = 3
LOOKED_AT = 20
BUSY = func.coalesce(Job.finished_ns - Job.started_ns, 0)


def pace_of(session: Session, kind: str) -> Pace:
    """What jobs took in the last runs of this kind that succeeded."""
    root_ids = [row.id for row in _newest().rows(session, {"kind": kind})]
    found = _took().rows(session, numbered(root_ids)) if root_ids else ()
    rows = [row for row in found if row[2]]
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
    """Seconds per recorded second, of the runs whose labels tell how long they were recorded."""
    rows = _lasted().rows(session, numbered(list(busy_s))) if busy_s else ()
    lasted_s = {row.job_id: row.duration_ns / 1e9 for row in rows if row.duration_ns}
    if not lasted_s:
        return {}
    return {SYNCHRONISE: sum(busy_s[job_id] for job_id in lasted_s) / sum(lasted_s.values())}


@cache
def _newest() -> KeptSelect:
    """The last runs of a kind that succeeded, of those that were begun last."""
    newest = select(Job.id, Job.state).where(Job.id == Job.root_id, Job.kind == parameter("kind"))
    looked_at = newest.order_by(Job.id.desc()).limit(literal_column(str(LOOKED_AT))).subquery()
    ended = select(looked_at.c.id).where(looked_at.c.state == "succeeded").order_by(looked_at.c.id.desc())
    return KeptSelect(ended.limit(literal_column(str(RECENT_RUNS))))


@cache
def _took() -> KeptSelect:
    """By run and kind, how many jobs succeeded and what they took.

    The state is no condition: SQLite would read all jobs that ever succeeded for it.
    """
    ended = and_(Job.state == "succeeded", Job.finished_ns.is_not(None))
    counted = (func.sum(case((ended, 1), else_=0)), cast(func.sum(case((ended, BUSY), else_=0)), BigInteger))
    of_runs = (Job.root_id.in_(numbered_parameters(RECENT_RUNS)), Job.queue != "")
    return KeptSelect(select(Job.root_id, Job.kind, *counted).where(*of_runs).group_by(Job.root_id, Job.kind))


@cache
def _lasted() -> KeptSelect:
    of_runs = LabelSet.job_id.in_(numbered_parameters(RECENT_RUNS))
    return KeptSelect(select(LabelSet.job_id, LabelSet.duration_ns).where(of_runs))
