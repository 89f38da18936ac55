"""The join stage: all counts of a submission become its score, or the list of its faults.

**Conventions.** Counts come from an earlier score against the same ground truth or from parts; missing counts are
computed here. One version of the code counts everything in a score. Slow work comes first; rows, consequences for the
submission and the job's success are one transaction. A job's result contains only the submission's state.
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
    """Score the submission by the evaluation version, unless it has that score or needs no score any more."""
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
    """Return the outcome for a completely examined submission."""
    if not whole.validation.ok:
        return refuse(context, case, whole.validation)
    if whole.counts is None:
        return Outcome({"state": "valid"}, commit=partial(write_verdict, case, "valid", None))
    new = made_score(context, case, evaluation_version, whole.counts)
    return Outcome({"state": "scored"}, commit=partial(write, context, case, new))


def gaps(parts: Sequence[ScorePart], frames: int) -> Iterator[Span]:
    """Yield the ranges of [0, frames) that no part covers; parts are sorted and do not overlap."""
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
    """Return the parts counted by this code version, in order; parts of other versions are counted again."""
    of_both = (ScorePart.submission_id == case.submission_id, ScorePart.truth_id == case.truth.id)
    ours = select(ScorePart).where(*of_both, ScorePart.code_version == code_version("scores"))
    return session.scalars(ours.order_by(ScorePart.start)).all()


def _whole(context: EvalStageContext, case: Case, parts: Sequence[ScorePart]) -> ExaminedRange:
    """Return all frames, in order."""
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
    """Return the score of these counts with its files stored; it records the code version that counted.

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
        confusions=_store(context, npz_bytes(counts.arrays())),
        spectra=_store(context, spectra_npz(spectra)),
        content_sha256=sha256(counts.confusions.astype("<i4").tobytes()).hexdigest(),
    )


def sequences_of(truth: ReadyTruth) -> tuple[SequenceFacts, ...]:
    """Return the sequences of a ground truth in the order of its frames."""
    return tuple(
        SequenceFacts(
            *(sequence["name"], sequence["frames"], sequence["environment"] or None, sequence["illumination"] or None),
            *(sequence.get("drive") or None, sequence.get("first_stamp_ns")),  # an earlier version had no drives
            tuple(sequence.get("places", ())),
        )
        for sequence in truth.facts["sequences"]
    )


def _store(context: EvalStageContext, content: bytes) -> PreparedBlob:
    """Store the content from a file of this attempt: stored files may share their bytes, so none is rewritten."""
    path = context.folder / f"{token_hex(8)}.npz"
    path.write_bytes(content)
    return prepare(context.platform.store, context.platform.database, path, adopt=True)


# Final states of submissions, written in the transaction in which their last job succeeds. The first join settles the
# submission, by the evaluation version that was active at its start. Jobs for all other pending or newly active
# versions are added to the run in the same transaction. The phase's row is locked meanwhile: a re-score that starts
# concurrently either reads the submission as scored or is included. Locks are taken in the order run, submission, team,
# phase.


Stage = Callable[[EvalStageContext], Outcome]


def settling(stage: Stage, context: EvalStageContext) -> Outcome:
    """Return the stage's outcome; a refusal ends the submission, not the job, and platform faults are raised."""
    try:
        return stage(context)
    except JobCancelledError:
        raise
    except StoneError as error:
        if not is_refusal(error):
            raise
        context.attempt.log("not scored", "warning", code=error.code)
        return Outcome({"refused": error.code}, commit=partial(_fail, context.submission_id, error))


def refuse(context: EvalStageContext, case: Case, validation: Validation) -> Outcome:
    """Return the outcome of an invalid submission; a submission with a score by another version stays scored."""
    if not case.is_under_way:
        return Outcome({"state": "unscorable"}, commit=partial(_give_up, case))
    context.attempt.log("not valid", errors=validation.errors_total, first=validation.errors[0].code)
    return Outcome({"state": "invalid"}, commit=partial(write_verdict, case, "invalid", validation))


def write_verdict(case: Case, state: str, validation: Validation | None, session: Session) -> None:
    """End a submission without a score. Raises `JobCancelledError` if it ended in another state meanwhile."""
    settle(session, case.submission_id, state, problems=validation.as_record() if validation else None)


def write(context: EvalStageContext, case: Case, new: NewScore, session: Session) -> None:
    """Write the score and, the first time, end the submission. Raises as `write_verdict`."""
    score = write_score(session, new)
    if settle(session, case.submission_id, "scored"):
        raise_alarms(session, score)
        _score_by_the_others(context, case, session)


def _score_by_the_others(context: EvalStageContext, case: Case, session: Session) -> None:
    """Queue jobs for every version whose score is missing, unless the run is being cancelled."""
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
    """End the submission as failed, unless it is scored."""
    submission = live_submission(session, submission_id)
    if submission.state != "scored":
        settle(session, submission_id, "failed", failure=Failure(error.code, str(error)))
    if isinstance(error, ImpossibleCountsError):
        raise_impossible_counts(session, submission)
