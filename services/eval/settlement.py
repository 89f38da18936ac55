"""Final states of submissions, written in the transaction in which their last job succeeds.

**Conventions.** The first join settles it, by the evaluation version in force when it began; after that it lacks the
score of every evaluation version that is pending or came into force meanwhile, so jobs for these are added to its run
in the same transaction. The phase's row is held while that is decided: a re-score that begins at the same time either
sees the submission scored or is seen. Locks are taken in the order run, submission, team, phase.
"""

from collections.abc import Callable
from functools import partial

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.domain.benchmarks.alarms.alarms import raise_alarms
from services.domain.benchmarks.phases.evaluation_versions import versions_to_score
from services.domain.benchmarks.submissions.scores import NewScore, drop_parts, write_score
from services.domain.benchmarks.submissions.scoring_jobs import rescore_specs
from services.domain.benchmarks.submissions.submissions import settle
from services.eval.cases import Case, live_submission
from services.eval.stage_context import EvalStageContext
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.completion import Failure
from services.runtime.jobs.enqueue import add_jobs
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.execution import is_refusal
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Phase
from stone.errors import StoneError
from stone_submissions.verdict import Validation

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
    if live_submission(session, submission_id).state != "scored":
        settle(session, submission_id, "failed", failure=Failure(error.code, str(error)))
