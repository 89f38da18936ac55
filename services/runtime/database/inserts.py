"""INSERT … ON CONFLICT DO NOTHING, for SQLite and PostgreSQL."""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import inspect
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from services.runtime.orm import Base


def insert_new(session: Session, row: type[Base], values: Sequence[Mapping[str, Any]]) -> list[str]:
    """Insert rows with new keys; return the first primary key column of each inserted row.

    Waits for concurrent inserts and deletions of the same key, and then uses their result.
    """
    if not values:
        return []
    key = inspect(row).primary_key[0]
    dialect = sqlite if session.get_bind().dialect.name == "sqlite" else postgresql
    statement = dialect.insert(row).values(list(values)).on_conflict_do_nothing().returning(key)
    return list(session.scalars(statement))
