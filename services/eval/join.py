"""The join stage: all counts of a submission become its score, or the list of what is wrong with it.

**Conventions.** Counts come from wherever they are: kept with an earlier score against the same ground truth, from
parts, and where neither has them they are counted here; all of one score were counted by one version of the code. Slow
things come first; rows, what follows for the submission and the job's success are one transaction. What a job answers
tells nothing but where the submission stands.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from hashlib import sha256
from pathlib import Path
from secrets import token_hex

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.alarms.alarms import raise_alarms, raise_impossible_counts
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, versions_to_score
from services.domain.benchmarks.submissions.score_rows import NewScore, drop_parts, write_score
from services.domain.benchmarks.submissions.scoring_jobs import rescore_specs
from services.domain.benchmarks.submissions.scoring_ranges import Span
from services.domain.benchmarks.submissions.submissions import settle
from services.eval.examination import Counts, ExaminedRange, ImpossibleCountsError, counts_in, joined, unpacked
from services.eval.scored_case import Case, ReadyTruth, live_submission
from services.eval.scoring_workspace import EvalStageContext
from services.eval.spectra_file import spectra_npz
from services.runtime.code_version import code_version
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.enqueue import add_jobs
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.execution import is_refusal
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Phase, Score, ScorePart
from services.runtime.store.blobs import PreparedBlob, prepare
from stone.errors import StoneError
from stone.scoring.score_record import SequenceFacts, SubmissionCounts, record_of
from stone.scoring.signature import Signature
from stone_files.npz import npz_bytes
from stone_submissions.verdict import Validation, merged, validation_of


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
        return counts_in(arrays)


# Scores from counts: the record, the intervals and the two stored files of a score.


def made_score(
    context: EvalStageContext, case: Case, evaluation_version: EvaluationVersion, counts: Counts
) -> NewScore:
    """The score of these counts, its files stored; it bears the version of the code that counted.

    Raises `unknown_metric`, and what the store raises.
    """
    counts_of_frames = SubmissionCounts(
        counts.confusions, counts.bev, sequences_of(case.truth), counts.column_counts, counts.late
    )
    spectra = counts_of_frames.spectra(evaluation_version.metric)
    return NewScore(
        submission_id=case.submission_id,
        evaluation_version=evaluation_version,
        signature=str(Signature(case.truth.sha256, case.truth.mask, evaluation_version.metric, case.truth.grid)),
        record={
            "code_version": case.kept.code_version if case.kept else code_version("scores"),
            **record_of(counts_of_frames, spectra, evaluation_version.metric),
        },
        confusions=_stored(context, npz_bytes(counts.arrays())),
        spectra=_stored(context, spectra_npz(spectra)),
        content_sha256=sha256(counts.confusions.astype("<i4").tobytes()).hexdigest(),
    )


def sequences_of(truth: ReadyTruth) -> tuple[SequenceFacts, ...]:
    """The sequences of a ground truth in the order of its frames."""
    return tuple(
        SequenceFacts(
            *(one["name"], one["frames"], one["environment"] or None, one["illumination"] or None),
            *(one.get("drive") or None, one.get("first_stamp_ns")),  # an earlier version knew no drives
            tuple(one.get("places", ())),
        )
        for one in truth.facts["sequences"]
    )


def _stored(context: EvalStageContext, content: bytes) -> PreparedBlob:
    """Each attempt writes a file of its own: what is stored may share its bytes, so none is written twice."""
    path = context.folder / f"{token_hex(8)}.npz"
    path.write_bytes(content)
    return prepare(context.platform.store, context.platform.database, path, adopt=True)


# Final states of submissions, written in the transaction in which their last job succeeds.
#
# **Conventions.** The first join settles it, by the evaluation version in force when it began; after that it lacks the
# score of every evaluation version that is pending or came into force meanwhile, so jobs for these are added to its
# run in the same transaction. The phase's row is held while that is decided: a re-score that begins at the same time
# either sees the submission scored or is seen. Locks are taken in the order run, submission, team, phase.


Stage = Callable[[EvalStageContext], Outcome]


def settling(stage: Stage, context: EvalStageContext) -> Outcome:
    """What the stage answers; a refusal ends the submission, not the job, and a fault of the platform goes on."""
    try:
        return stage(context)
    except JobCancelledError:
        raise
    except StoneError as error:
        if not is_refusal(error):
            raise
        context.attempt.log("not scored", "warning", code=error.code)
        return Outcome({"refused": error.code}, commit=partial(_fail, context.submission_id, error))


def refuse(context: EvalStageContext, case: Case, found: Validation) -> Outcome:
    """The submission is not valid; one that has a score stays scored, without one by another evaluation version."""
    if not case.is_under_way:
        return Outcome({"state": "unscorable"}, commit=partial(_give_up, case))
    context.attempt.log("not valid", errors=found.errors_total, first=found.errors[0].code)
    return Outcome({"state": "invalid"}, commit=partial(write_verdict, case, "invalid", found))


def write_verdict(case: Case, state: str, found: Validation | None, session: Session) -> None:
    """End a submission without a score. Raises `JobCancelledError` where it ended otherwise meanwhile."""
    settle(session, case.submission_id, state, problems=found.as_record() if found else None)


def write(context: EvalStageContext, case: Case, new: NewScore, session: Session) -> None:
    """Write the score and, the first time, end the submission. Raises as `write_verdict` does."""
    score = write_score(session, new)
    if settle(session, case.submission_id, "scored"):
        raise_alarms(session, score)
        _score_by_the_others(context, case, session)


def _score_by_the_others(context: EvalStageContext, case: Case, session: Session) -> None:
    """Have the run score it by every version that it lacks by now; a run that is being stopped takes nothing new."""
    session.execute(select(Phase.id).where(Phase.id == case.phase_id).with_for_update(read=True))
    run = lock_run(session, context.attempt.root_id)
    if run.cancel_reason:
        return
    for evaluation_version in versions_to_score(session, case.phase_id):
        specs = rescore_specs(session, (case.submission_id,), evaluation_version)
        add_jobs(session, run, specs, context.platform.settings.jobs.max_attempts)


def _give_up(case: Case, session: Session) -> None:
    drop_parts(session, case.submission_id, case.truth.id)


def _fail(submission_id: str, error: StoneError, session: Session) -> None:
    """A scored submission stays scored."""
    submission = live_submission(session, submission_id)
    if submission.state != "scored":
        settle(session, submission_id, "failed", failure=Failure(error.code, str(error)))
    if isinstance(error, ImpossibleCountsError):
        raise_impossible_counts(session, submission)
