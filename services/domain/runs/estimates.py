"""The one estimate of the seconds that runs have left, of which every page, list, event and command shows the same."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.submissions.completion_estimate import expected_of
from services.domain.runs.paces import pace_of
from services.domain.runs.run_rows import AliveRow, alive_rows, older_of_the_same
from services.domain.runs.time_left import rounded_s, seconds_left
from services.domain.runs.work import AliveRun, alive_runs
from services.runtime.orm import SubmissionRow
from services.runtime.orm.base import now_ns

SCORE = "score"
IMPORT, SCENE = "dataset.import", "labeler.import_scene"


def time_left(session: Session, job_ids: Sequence[str]) -> Mapping[str, int]:
    """Seconds left by id, rounded up, of those of the jobs that are runs, alive, and of which it can be told.

    A job within a run has none: its run's is the estimate. Nor has a run while a queue that it needs is paused.
    """
    runs = alive_rows(session, job_ids)
    if not runs:
        return {}
    scores = [run for run in runs if run.kind == SCORE]
    return {**_of_others(session, [run for run in runs if run.kind != SCORE]), **_of_scores(session, scores)}


def _of_others(session: Session, runs: list[AliveRow]) -> dict[str, int]:
    if not runs:
        return {}
    asked = {run.id for run in runs}
    before = [run for run in older_of_the_same(session, runs) if run.id not in asked]
    alive = alive_runs(session, [*runs, *before], now_ns())
    paces = {kind: pace_of(session, kind) for kind in {one.run.kind for one in alive}}
    left = {one.run.id: None if _is_untold(one) else seconds_left(one.work, paces[one.run.kind]) for one in alive}
    ahead_s = _ahead_s(alive, left)
    told = {run_id: own_s for run_id, own_s in left.items() if own_s is not None and run_id in asked}
    return {run_id: rounded_s(own_s + ahead_s[run_id]) for run_id, own_s in told.items()}


def _ahead_s(alive: Sequence[AliveRun], left: Mapping[str, float | None]) -> dict[str, float]:
    """By run, the seconds that older runs of the same owner have left in its queue, whose jobs are taken first."""
    sums, ahead_s = defaultdict[tuple[str, str, int], float](float), dict[str, float]()
    for one in sorted(alive, key=lambda one: one.run.id):
        same = (one.queue, one.run.owner_id, one.run.priority)
        ahead_s[one.run.id] = sums[same]
        sums[same] += left[one.run.id] or 0.0
    return ahead_s


def _is_untold(one: AliveRun) -> bool:
    """Whether it cannot be told: a queue is paused, or an import has not read yet which scenes there are."""
    scenes = any(stage.kind == SCENE for stage in one.work.stages)
    return one.is_paused or (one.run.kind == IMPORT and not scenes)


def _of_scores(session: Session, runs: list[AliveRow]) -> dict[str, int]:
    """As the submission's page says it."""
    if not runs:
        return {}
    scored = select(SubmissionRow).where(SubmissionRow.job_id.in_([run.id for run in runs]))
    return expected_of(session, session.scalars(scored).all())
