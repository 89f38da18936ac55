"""What `eval` does in the queue, stage by stage; counting and scores are those that `pipeline.score` calls.

    open → part (each range of frames) → join (each evaluation version); truth; compare

**Conventions.** A stage may run twice, at once or after being killed anywhere: what it writes is one row each time, in
the transaction of its success. A submission that is refused is no failed job: the job succeeds, the submission has
ended. Neither result nor log line nor failure tells anything of a ground truth.
"""

from functools import partial

from sqlalchemy.orm import Session

from services.domain.benchmarks.phases.evaluation_versions import active
from services.domain.benchmarks.submissions.scores import CountedPart, write_part
from services.domain.benchmarks.submissions.scoring_jobs import JOIN, OPEN, PART, TRUTH, scoring_specs
from services.domain.benchmarks.submissions.submissions import mark_scoring
from services.domain.sequences.label_comparisons import COMPARE
from services.eval.cases import live_submission
from services.eval.comparison.stage import compare_label_sets
from services.eval.file_keeping import keep_file
from services.eval.join import concluded, join
from services.eval.scoring_errors import TruthUnreadyError
from services.eval.settlement import Stage, refuse, settling
from services.eval.stage_context import EvalStageContext
from services.eval.truth_build import build_truth
from services.runtime.code_version import code_version
from services.runtime.jobs.specs import Attempt, Handlers, Outcome
from services.runtime.platform import Platform


def handlers(platform: Platform) -> Handlers:
    """The stages by kind."""
    stages: dict[str, Stage] = {
        OPEN: partial(settling, open_submission),
        PART: partial(settling, count_part),
        JOIN: partial(settling, join),
        TRUTH: build_truth,
        COMPARE: compare_label_sets,
    }
    return {kind: partial(_with_context, platform, stage) for kind, stage in stages.items()}


def open_submission(context: EvalStageContext) -> Outcome:
    """The file is kept and its directory checked; what has one part's worth of frames is looked at at once.

    Raises `JobCancelledError`, `UploadDamagedError`, `TruthUnreadyError`, `ScoringCrashedError`.
    """
    with context.platform.database.reading() as session:
        submission = live_submission(session, context.submission_id)
        evaluation_version = active(session, submission.phase_id)
    context.attempt.progress("keep", 0, 1)
    keep_file(context.platform, submission)
    if evaluation_version is None:
        raise TruthUnreadyError(f"phase {submission.phase_id}")
    case = context.case(evaluation_version.truth_id)
    if not case.is_under_way:
        return Outcome({"state": case.state})
    following = scoring_specs(case.submission_id, evaluation_version, case.truth.frames)
    is_small = len(following) == 1  # the join alone: it would count all of it
    found = context.examined(case, (0, case.truth.frames if is_small else 0))
    if is_small:
        return concluded(context, case, evaluation_version, found)
    if not found.validation.ok:
        return refuse(context, case, found.validation)
    return Outcome({"state": case.state}, then=following)


def count_part(context: EvalStageContext) -> Outcome:
    """The counts of a range of frames, kept until the join. Raises as `open_submission` does, and `PurgedError`."""
    truth_id, start, stop = (context.attempt.arguments[name] for name in ("truth_id", "start", "stop"))
    case = context.case(truth_id)
    if case.is_over or case.kept is not None:
        return Outcome({"state": case.state})
    found = context.examined(case, (start, stop))
    counts = found.counts.packed() if found.counts else b""
    part = CountedPart(
        case.submission_id, truth_id, start, stop, counts, found.validation.as_record(), code_version("scores")
    )

    def write(session: Session) -> None:
        mark_scoring(session, case.submission_id)
        write_part(session, part)

    return Outcome({"frames": stop - start}, commit=write)


def _with_context(platform: Platform, stage: Stage, attempt: Attempt) -> Outcome:
    return stage(EvalStageContext(platform, attempt))
