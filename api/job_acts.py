"""An administrator's acts on runs: one, or the same on many with what came of each."""

from sqlalchemy.orm import Session

from api import audit
from api.deps import Caller
from api.schemas.admin import JobAct, JobActItem, JobActsBody
from api.schemas.jobs import FailureItem
from api.visible import job_of
from services.runtime.benchmarks.submission_states import reopen
from services.runtime.jobs import steering
from services.runtime.orm import Job
from services.runtime.platform import Platform
from stone.errors import StoneError


def steer(session: Session, platform: Platform, act: JobAct, root_id: str, reason: str) -> Job:
    """The run after the act. Raises `JobStateError`."""
    if act == "retry":
        run = steering.retry(session, root_id, platform.settings.jobs.max_attempts)
        reopen(session, run)
        return run
    return (steering.cancel if act == "cancel" else steering.terminate)(session, root_id, reason)


def act_on_each(platform: Platform, caller: Caller, body: JobActsBody) -> list[JobActItem]:
    """What came of each, in the order asked; each is a transaction and a line of the audit log of its own.

    Jobs of one run are one act; what is refused keeps nothing of the rest from being done.
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
            run = steer(session, platform, body.act, root_id, body.reason)
            audit.record_admin_act(session, caller, f"job.{body.act}", root_id, body.reason)
            session.flush()
            item = JobActItem(job_id=job_id, root_id=root_id, state=run.state, failure=None)
    except StoneError as error:
        failure = FailureItem(code=error.code, sentence=str(error))
        return JobActItem(job_id=job_id, root_id=root_id, state=None, failure=failure)
    done[root_id] = item
    return item
