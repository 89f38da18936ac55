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
    """The number of rows it changed; 0 means that somebody else was first."""
    result = session.execute(statement.execution_options(synchronize_session=False))
    return cast("CursorResult[None]", result).rowcount


def lock_run(session: Session, root_id: str) -> Job:
    """The run's row, locked until the end of the transaction: endings within one run come one after another."""
    return session.scalars(LOCKED, {"root": root_id}).one()


def revise_run(session: Session, root_id: str) -> Job:
    """As `lock_run`, and its revision has grown: one statement for both."""
    revised = update(Job).where(Job.id == root_id).values(revision=Job.revision + 1).returning(Job)
    return session.scalars(revised, execution_options={"populate_existing": True, "synchronize_session": False}).one()
