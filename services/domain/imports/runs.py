"""The run of an import as its stages see it: which import an attempt works for, and when its run is begun anew.

**Conventions.** As `services/domain/sequences/restart.py`: one import is made by one version of the code, so a run that
another began ends, and one of the same request takes its place; so does one whose files were removed meanwhile.
"""

from sqlalchemy import Select, select
from sqlalchemy.orm import Session

from services.domain.imports.requests import begin_import_again
from services.domain.sequences.restart import (
    MOST_RESTARTS,
    RESTARTS,
    CodeChangedError,
    RestartedTooOftenError,
)
from services.runtime.code_version import code_version
from services.runtime.jobs.changes import lock_run
from services.runtime.jobs.errors import JobCancelledError, QueueDrainingError
from services.runtime.jobs.specs import TERMINAL, Attempt
from services.runtime.orm import DatasetImport, Job
from services.runtime.platform import Platform

REMEDY = "Try it again later"
GONE = "its import was deleted, or is made by another run"


def import_of_attempt(platform: Platform, attempt: Attempt) -> DatasetImport:
    """The import that the attempt's run makes, which this version of the code began.

    Raises `JobCancelledError` where it was deleted, or another version began it, once it is begun again;
    `CodeChangedError` where that is not possible now.
    """
    with platform.database.reading() as session:
        begun = session.get_one(Job, attempt.root_id).arguments["code_version"]
        imported = _found(session, _made_by(attempt))
    if begun == code_version("imports"):
        return imported
    try:
        begin_run_again(platform, attempt, f"the platform was upgraded to code version {code_version('labels')}")
    except (QueueDrainingError, RestartedTooOftenError) as error:
        raise CodeChangedError((begun, code_version("imports")), error, REMEDY) from error
    raise JobCancelledError(f"its run was begun by version {begun}; the dataset is imported by another run")


def begin_run_again(platform: Platform, attempt: Attempt, reason: str) -> None:
    """Have another run take the place of the attempt's, unless that has ended, is to stop, or its import was deleted.

    So of jobs that ask at once, one begins a run. Raises `QueueDrainingError`, `RestartedTooOftenError`.
    """
    with platform.database.transaction() as session:
        old = lock_run(session, attempt.root_id)
        imported = session.scalars(_made_by(attempt).with_for_update(key_share=True)).one_or_none()
        if imported is None or old.state in TERMINAL or old.cancel_reason:
            return
        restarts = old.arguments.get(RESTARTS, 0) + 1
        if restarts > MOST_RESTARTS:
            raise RestartedTooOftenError(MOST_RESTARTS)
        new = begin_import_again(session, imported, reason, restarts)
        old.cancel_reason = f"{reason}; the dataset is imported by job {new.id} instead"


def kept_import(session: Session, attempt: Attempt) -> DatasetImport:
    """The import, locked until the end of the transaction. Raises `JobCancelledError`."""
    return _found(session, _made_by(attempt).with_for_update(key_share=True))


def _found(session: Session, statement: Select[DatasetImport]) -> DatasetImport:
    imported = session.scalars(statement.execution_options(populate_existing=True)).one_or_none()
    if imported is None:
        raise JobCancelledError(GONE)
    return imported


def _made_by(attempt: Attempt) -> Select[DatasetImport]:
    return select(DatasetImport).where(DatasetImport.job_id == attempt.root_id)
