"""Actions on runs: cancel, terminate, retry, for one run or, by administrators, many."""

from sqlalchemy.orm import Session

from api import audit
from api.deps import Caller
from api.schemas.admin import JobAct, JobActItem, JobActsBody
from api.schemas.jobs import FailureItem
from api.visible import job_of
from services.domain.benchmarks.submissions.state_machine import reopen
from services.runtime.jobs import control
from services.runtime.notifications.events import tell_run_stopped
from services.runtime.orm import Job
from services.runtime.platform import Platform
from stone.errors import StoneError

UNSAID = "no reason was given"


def control_run(session: Session, platform: Platform, caller: Caller, act: JobAct, root_id: str, reason: str) -> Job:
    """Apply the act and return the run; notify its owner if another user stopped it. Raises `JobStateError`."""
    if act == "retry":
        run = control.retry(session, root_id, platform.settings.jobs.max_attempts)
        reopen(session, run)
        return run
    before = session.get_one(Job, root_id)
    is_own, is_told = before.owner_id == caller.user_id, bool(before.cancel_reason)
    shown_reason = reason if reason or is_own else UNSAID
    run = (control.cancel if act == "cancel" else control.terminate)(session, root_id, shown_reason)
    if not is_own and not is_told:
        tell_run_stopped(session, run, shown_reason)
    return run


def act_on_each(platform: Platform, caller: Caller, body: JobActsBody) -> list[JobActItem]:
    """Apply one act to each run and return the results in the requested order; each is its own transaction and audit
    line.

    Jobs of one run count as one act. A refused act does not stop the others.
    """
    done: dict[str, JobActItem] = {}
    return [_acted(platform, caller, body, job_id, done) for job_id in dict.fromkeys(body.job_ids)]


def _acted(
    platform: Platform, caller: Caller, body: JobActsBody, job_id: str, done: dict[str, JobActItem]
) -> JobActItem:
    root_id: str | None = None
    try:
        with platform.database.transaction() as session:
            root_id = job_of(session, caller, job_id).root_id
            if root_id in done:
                return done[root_id].model_copy(update={"job_id": job_id})
            run = control_run(session, platform, caller, body.act, root_id, body.reason)
            audit.record_admin_act(session, caller, f"job.{body.act}", root_id, body.reason)
            session.flush()
            item = JobActItem(job_id=job_id, root_id=root_id, state=run.state, failure=None)
    except StoneError as error:
        failure = FailureItem(code=error.code, sentence=str(error))
        return JobActItem(job_id=job_id, root_id=root_id, state=None, failure=failure)
    done[root_id] = item
    return item
