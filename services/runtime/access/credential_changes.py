"""Detection of changed users, tokens or browser sessions, so that cached credentials are read again.

**Conventions.** `credentials_generation()` changes with every commit by this process that changes or deletes a
credential, before the commit returns. Recording a credential's last use does not count (`NOTES_USE`). Changes by other
processes are not detected, so caches must be short-lived.
"""

from itertools import count
from typing import Any

from sqlalchemy import event
from sqlalchemy.orm import ORMExecuteState, Session

from services.runtime.orm import Token, User, WebSession

NOTES_USE = {"stone_notes_use": True}
"""Execution options of a statement that only records the last use of a credential."""

_CREDENTIALS = (User, Token, WebSession)
_TABLES = frozenset(kind.__tablename__ for kind in _CREDENTIALS)
_CHANGED = "credentials_changed"
_numbers = count(1)
_generation = [0]


def credentials_generation() -> int:
    """Return a number that changes whenever this process changes credentials."""
    return _generation[0]


@event.listens_for(Session, "do_orm_execute")
def _note_statement(state: ORMExecuteState) -> None:
    if (state.is_update or state.is_delete) and not state.execution_options.get("stone_notes_use"):
        statement: Any = state.statement
        if statement.table.name in _TABLES:
            state.session.info[_CHANGED] = True


@event.listens_for(Session, "after_flush")
def _note_objects(session: Session, _context: object) -> None:
    if any(isinstance(changed, _CREDENTIALS) for changed in (*session.dirty, *session.deleted)):
        session.info[_CHANGED] = True


@event.listens_for(Session, "after_commit")
def _begin_generation(session: Session) -> None:
    if session.info.pop(_CHANGED, False):
        _generation[0] = next(_numbers)


@event.listens_for(Session, "after_rollback")
def _forget(session: Session) -> None:
    session.info.pop(_CHANGED, None)
