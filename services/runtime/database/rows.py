"""Frequent statements: their SQL is compiled once, and their rows are the driver's.

**Conventions.** For lists. Values are strings, integers or None, by the names of the statement's parameters; values of
an IN are literals or numbered parameters. Rows have the names of the columns. Driver values are not converted, so on
SQLite a boolean is 0 or 1. Listeners of `before_cursor_execute` see these statements too.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import BindParameter, Row, Select, String, bindparam
from sqlalchemy.orm import Session
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.types import TypeEngine

Values = Mapping[str, str | int | None]


def parameter(name: str, kind: type[TypeEngine[Any]] = String) -> BindParameter[Any]:
    """Return a parameter of a cached statement, whose value is given with each execution."""
    return bindparam(name, None, kind)  # with a value, since a parameter without one cannot be compiled in advance


def places_for(count: int) -> int:
    """Return the next power of two, so that few statements are cached for any number of values."""
    return 1 << max(0, count - 1).bit_length()


def numbered_parameters(places: int) -> list[BindParameter[Any]]:
    """Return the parameters of an IN with this number of values."""
    return [parameter(f"place_{number}") for number in range(places)]


def numbered(values: Sequence[str]) -> Values:
    """Return the values by number; missing values are NULL, which equals nothing."""
    return {f"place_{number}": value for number, value in enumerate(values)}


class KeptSelect:
    """`KeptSelect(statement).rows(session, values)`; shared by all sessions and threads."""

    def __init__(self, statement: Select[*tuple[Any, ...]]) -> None:
        self._statement = statement
        self._written: dict[str, tuple[str, Sequence[str] | None, Mapping[str, Any]]] = {}

    def rows(self, session: Session, values: Values) -> Sequence[Row[*tuple[Any, ...]]]:
        """Return all rows. A missing value is None."""
        connection = session.connection()
        dialect = connection.dialect.name
        if dialect not in self._written:
            self._written[dialect] = self._write(session)
        text, order, constants = self._written[dialect]
        named = {**constants, **values}
        given: Any = named if order is None else tuple(named[name] for name in order)
        return connection.exec_driver_sql(text, given).all()

    def _write(self, session: Session) -> tuple[str, Sequence[str] | None, Mapping[str, Any]]:
        compiled = self._statement.compile(session.connection(), compile_kwargs={"render_postcompile": True})
        order = compiled.positiontup
        return str(compiled), order if compiled.positional else None, _constants(compiled)


def _constants(compiled: SQLCompiler) -> dict[str, Any]:
    """Return the statement's own values in the driver's form, for example the path into a JSON column."""
    values = dict(compiled.params)
    for bound, name in compiled.bind_names.items():
        convert = bound.type.dialect_impl(compiled.dialect).bind_processor(compiled.dialect)
        if convert is not None and not bound.expanding:
            values[name] = convert(values[name])
    return values
