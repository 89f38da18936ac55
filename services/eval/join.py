"""The join stage: all counts of a submission become its score, or the list of what is wrong with it.

**Conventions.** Counts come from wherever they are: kept with an earlier score against the same ground truth, from
parts, and where neither has them they are counted here; all of one score were counted by one version of the code. Slow
things come first; rows, what follows for the submission and the job's success are one transaction. What a job answers
tells nothing but where the submission stands.
"""

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.submissions.scoring_jobs import Span
from services.eval.cases import Case
from services.eval.examination import unpacked
from services.eval.ranges import Counts, ExaminedRange, joined
from services.eval.scoring import made_score
from services.eval.settlement import refuse, write, write_verdict
from services.eval.stage_context import EvalStageContext
from services.runtime.code_version import code_version
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Score, ScorePart
from stone_submissions.verdict_record import merged, validation_of


def join(context: EvalStageContext) -> Outcome:
    """Score the submission by the evaluation version, unless that is done or nothing is to be scored any more."""
    evaluation_version = context.evaluation_version
    case = context.case(evaluation_version.truth_id)
    with context.platform.database.reading() as session:
        if case.is_over or _is_scored(session, case, evaluation_version):
            return Outcome({"state": case.state})
        parts = _parts(session, case)
    return concluded(context, case, evaluation_version, _whole(context, case, parts))


def concluded(
    context: EvalStageContext, case: Case, evaluation_version: EvaluationVersion, whole: ExaminedRange
) -> Outcome:
    """What becomes of a submission when all its frames were looked at."""
    if not whole.validation.ok:
        return refuse(context, case, whole.validation)
    if whole.counts is None:
        return Outcome({"state": "valid"}, commit=partial(write_verdict, case, "valid", None))
    new = made_score(context, case, evaluation_version, whole.counts)
    return Outcome({"state": "scored"}, commit=partial(write, context, case, new))


def gaps(parts: Sequence[ScorePart], frames: int) -> Iterator[Span]:
    """The ranges of [0, frames) that no part has; parts are in their order and do not overlap."""
    at = 0
    for part in parts:
        if part.start > at:
            yield at, part.start
        at = part.stop
    if at < frames:
        yield at, frames


def _is_scored(session: Session, case: Case, evaluation_version: EvaluationVersion) -> bool:
    by_version = (Score.truth_id == evaluation_version.truth_id, Score.metric == evaluation_version.metric)
    return session.scalar(select(Score.id).where(Score.submission_id == case.submission_id, *by_version)) is not None


def _parts(session: Session, case: Case) -> Sequence[ScorePart]:
    """Those that this code counted, in their order; what another version did, before an upgrade, is counted again."""
    of_both = (ScorePart.submission_id == case.submission_id, ScorePart.truth_id == case.truth.id)
    ours = select(ScorePart).where(*of_both, ScorePart.code_version == code_version("scores"))
    return session.scalars(ours.order_by(ScorePart.start)).all()


def _whole(context: EvalStageContext, case: Case, parts: Sequence[ScorePart]) -> ExaminedRange:
    """All frames, in their order."""
    if case.kept is not None:
        return ExaminedRange(merged(()), _kept_counts(context.platform.store.local(case.kept.object_key)))
    counted = {gap[0]: context.examined(case, gap) for gap in gaps(parts, case.truth.frames)}
    counted |= {part.start: _of_part(part) for part in parts}
    return joined(examined for _, examined in sorted(counted.items()))


def _of_part(part: ScorePart) -> ExaminedRange:
    counts = unpacked(part.counts, part.stop - part.start) if part.counts else None
    return ExaminedRange(validation_of(part.problems), counts)


def _kept_counts(path: Path) -> Counts:
    with np.load(path, allow_pickle=False) as arrays:
        return Counts(arrays["confusions"], arrays["bev"])
