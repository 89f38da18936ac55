"""Compare-and-set updates: an UPDATE or DELETE with its precondition, and whether it matched."""

from typing import cast

from sqlalchemy import CursorResult, Delete, Update, bindparam, select, update
from sqlalchemy.orm import Session

from services.runtime.orm import Job

LOCKED = (
    select(Job)
    .where(Job.id == bindparam("root"))
    .with_for_update(key_share=True)
    .execution_options(populate_existing=True)
)


def rows_changed(session: Session, statement: Update | Delete) -> int:
    """Return the number of rows it changed; 0 means that another transaction was first."""
    result = session.execute(statement.execution_options(synchronize_session=False))
    return cast("CursorResult[None]", result).rowcount


def lock_run(session: Session, root_id: str) -> Job:
    """Return the run's row, locked until the end of the transaction, which serialises endings within a run."""
    return session.scalars(LOCKED, {"root": root_id}).one()


def revise_run(session: Session, root_id: str) -> Job:
    """Lock the run as `lock_run` and increment its revision, in one statement."""
    revised = update(Job).where(Job.id == root_id).values(revision=Job.revision + 1).returning(Job)
    return session.scalars(revised, execution_options={"populate_existing": True, "synchronize_session": False}).one()
