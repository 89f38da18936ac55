"""How a submission ends, in the transaction of the success of the job that ends it.

**Conventions.** The first join settles it, by the pair in force when it began; after that it lacks the score of every
pair that is pending or came into force meanwhile, so jobs for these are added to its run in the same transaction. The
phase's row is held while that is decided: a re-score that begins at the same time either sees the submission scored or
is seen. Locks are taken in the order run, submission, team, phase.
"""

from collections.abc import Callable
from functools import partial

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.eval.cases import Case, standing_submission
from services.eval.desk import Desk
from services.eval.validation import Validation
from services.runtime.benchmarks.alarms import raise_alarms
from services.runtime.benchmarks.pairs import pairs_to_score
from services.runtime.benchmarks.scores import NewScore, drop_parts, write_score
from services.runtime.benchmarks.scoring_jobs import rescore_specs
from services.runtime.benchmarks.submissions import settle
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.errors import JobCancelledError
from services.runtime.jobs.finishing import Failure
from services.runtime.jobs.queueing import add_jobs
from services.runtime.jobs.running import is_refusal
from services.runtime.jobs.specs import Outcome
from services.runtime.orm import Phase
from stone.errors import StoneError

Stage = Callable[[Desk], Outcome]


def settling(stage: Stage, desk: Desk) -> Outcome:
    """What the stage answers; a refusal ends the submission, not the job, and a fault of the platform goes on."""
    try:
        return stage(desk)
    except JobCancelledError:
        raise
    except StoneError as error:
        if not is_refusal(error):
            raise
        desk.attempt.log("not scored", "warning", code=error.code)
        return Outcome({"refused": error.code}, commit=partial(_fail, desk.submission_id, error))


def refuse(desk: Desk, case: Case, found: Validation) -> Outcome:
    """The submission is not valid; one that has a score stays scored, without one by another pair."""
    if not case.is_under_way:
        return Outcome({"state": "unscorable"}, commit=partial(_give_up, case))
    desk.attempt.log("not valid", errors=found.errors_total, first=found.errors[0].code)
    return Outcome({"state": "invalid"}, commit=partial(write_verdict, case, "invalid", found))


def write_verdict(case: Case, state: str, found: Validation | None, session: Session) -> None:
    """End a submission without a score. Raises `JobCancelledError` where it ended otherwise meanwhile."""
    settle(session, case.submission_id, state, problems=found.as_record() if found else None)


def write(desk: Desk, case: Case, new: NewScore, session: Session) -> None:
    """Write the score and, the first time, end the submission. Raises as `write_verdict` does."""
    score = write_score(session, new)
    if settle(session, case.submission_id, "scored"):
        raise_alarms(session, score)
        _score_by_the_others(desk, case, session)


def _score_by_the_others(desk: Desk, case: Case, session: Session) -> None:
    """Have the run score it by every pair that it lacks by now; a run that is being stopped takes nothing new."""
    session.execute(select(Phase.id).where(Phase.id == case.phase_id).with_for_update(read=True))
    run = lock_run(session, desk.attempt.root_id)
    if run.cancel_reason:
        return
    for pair in pairs_to_score(session, case.phase_id):
        specs = rescore_specs(session, (case.submission_id,), pair)
        add_jobs(session, run, specs, desk.platform.settings.jobs.max_attempts)


def _give_up(case: Case, session: Session) -> None:
    drop_parts(session, case.submission_id, case.truth.id)


def _fail(submission_id: str, error: StoneError, session: Session) -> None:
    """A scored submission stays scored."""
    if standing_submission(session, submission_id).state != "scored":
        settle(session, submission_id, "failed", failure=Failure(error.code, str(error)))
