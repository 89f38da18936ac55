"""Noticing that users, tokens or browsers' sessions changed, so that what is remembered of them is read again.

**Conventions.** `credentials_generation()` is another number after every commit by this process that changed or deleted
one of them, whoever did it and why; before the commit returns. Noting when a credential was last used changes nothing
of it (`NOTES_USE`). Of other processes nothing is noticed: what is remembered must be short-lived.
"""

from itertools import count
from typing import Any

from sqlalchemy import event
from sqlalchemy.orm import ORMExecuteState, Session

from services.runtime.orm import Token, User, WebSession

NOTES_USE = {"stone_notes_use": True}
"""Execution options of a statement that says when a credential was last used, and nothing else."""

_CREDENTIALS = (User, Token, WebSession)
_TABLES = frozenset(kind.__tablename__ for kind in _CREDENTIALS)
_CHANGED = "credentials_changed"
_numbers = count(1)
_generation = [0]


def credentials_generation() -> int:
    """The number that stands for credentials as this process last changed them."""
    return _generation[0]


@event.listens_for(Session, "do_orm_execute")
def _note_statement(state: ORMExecuteState) -> None:
    if (state.is_update or state.is_delete) and not state.execution_options.get("stone_notes_use"):
        statement: Any = state.statement
        if statement.table.name in _TABLES:
            state.session.info[_CHANGED] = True


@event.listens_for(Session, "after_flush")
def _note_objects(session: Session, _context: object) -> None:
    if any(isinstance(one, _CREDENTIALS) for one in (*session.dirty, *session.deleted)):
        session.info[_CHANGED] = True


@event.listens_for(Session, "after_commit")
def _begin_generation(session: Session) -> None:
    if session.info.pop(_CHANGED, False):
        _generation[0] = next(_numbers)


@event.listens_for(Session, "after_rollback")
def _forget(session: Session) -> None:
    session.info.pop(_CHANGED, None)
