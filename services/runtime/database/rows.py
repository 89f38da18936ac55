"""Statements that are asked often: their SQL is written once, and their rows are what the driver answers.

**Conventions.** For lists. Values are strings, integers or None, under the names of the statement's parameters; those
of an IN are literals of it or numbered. Rows have the names of the columns; nothing converts what the driver gives,
so on SQLite a boolean is 0 or 1. What looks on at statements (`before_cursor_execute`) sees these too.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from sqlalchemy import BindParameter, Row, Select, String, bindparam
from sqlalchemy.orm import Session
from sqlalchemy.sql.compiler import SQLCompiler
from sqlalchemy.types import TypeEngine

Values = Mapping[str, str | int | None]


def parameter(name: str, kind: type[TypeEngine[Any]] = String) -> BindParameter[Any]:
    """A parameter of a kept statement, whose value comes with each question."""
    return bindparam(name, None, kind)  # with a value, since one without cannot be written ahead


def places_for(count: int) -> int:
    """The next power of two: so that few statements are kept for any number of values."""
    return 1 << max(0, count - 1).bit_length()


def numbered_parameters(places: int) -> list[BindParameter[Any]]:
    """The parameters of an IN with so many places."""
    return [parameter(f"place_{place}") for place in range(places)]


def numbered(values: Sequence[str]) -> Values:
    """The values of the first places; the rest are NULL, which equals nothing."""
    return {f"place_{place}": value for place, value in enumerate(values)}


class KeptSelect:
    """`KeptSelect(statement).rows(session, values)`; one for all sessions and threads."""

    def __init__(self, statement: Select[*tuple[Any, ...]]) -> None:
        self._statement = statement
        self._written: dict[str, tuple[str, Sequence[str] | None, Mapping[str, Any]]] = {}

    def rows(self, session: Session, values: Values) -> Sequence[Row[*tuple[Any, ...]]]:
        """All rows. A value that is missing is None."""
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
    """The statement's own values as the driver is given them, say the path into a JSON column."""
    told = dict(compiled.params)
    for bound, name in compiled.bind_names.items():
        convert = bound.type.dialect_impl(compiled.dialect).bind_processor(compiled.dialect)
        if convert is not None and not bound.expanding:
            told[name] = convert(told[name])
    return told
