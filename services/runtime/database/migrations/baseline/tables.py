"""Constructors of the baseline's tables, columns and indexes, which name every constraint.

**Conventions.** A table's indexes are created in the order of their definition: if two serve a query equally well,
SQLite uses the later one.
"""

from typing import Any

from sqlalchemy import Column, ForeignKey, Index, MetaData, String, Table, TextClause, text
from sqlalchemy.schema import SchemaItem
from sqlalchemy.types import TypeEngine

ID = String(32)
SHA256 = String(64)
METADATA = MetaData(
    naming_convention={
        "ix": "ix_%(table_name)s_%(column_0_N_name)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "ck": "ck_%(table_name)s_%(constraint_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

Type = TypeEngine[Any] | type[TypeEngine[Any]]


def table(name: str, *parts: SchemaItem) -> None:
    Table(name, METADATA, *parts, info={"indexes": [part for part in parts if isinstance(part, Index)]})


def key(name: str, type_: Type, *more: SchemaItem) -> Column[Any]:
    """Return a column of the primary key."""
    return Column(name, type_, *more, primary_key=True, autoincrement=False)


def required(name: str, type_: Type, *more: SchemaItem, **options: Any) -> Column[Any]:
    return Column(name, type_, *more, nullable=False, **options)


def optional(name: str, type_: Type, *more: SchemaItem, **options: Any) -> Column[Any]:
    return Column(name, type_, *more, nullable=True, **options)


def part_of(column: str) -> ForeignKey:
    """Return a reference to a row whose deletion deletes this row too."""
    return ForeignKey(column, ondelete="CASCADE")


def indexes(*columns: str) -> list[Index]:
    """Return one index for each column."""
    return [Index(None, column) for column in columns]


def partial_index(name: str, where: str, *columns: str | TextClause, unique: bool = False) -> Index:
    """Return an index of the rows that match `where`, in literals that both databases understand."""
    return Index(name, *columns, unique=unique, sqlite_where=text(where), postgresql_where=text(where))
