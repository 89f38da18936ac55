"""The database's clock as an SQL expression, so that machines with different clocks agree on ages.

**Conventions.** Nanoseconds since 1970, with the database's precision (SQLite: milliseconds).
"""

from typing import Any

from sqlalchemy import BigInteger
from sqlalchemy.ext.compiler import compiles
from sqlalchemy.sql.functions import FunctionElement


class database_ns(FunctionElement[int]):  # noqa: N801  # an SQL function
    """The database's clock when it runs the statement, not at the transaction's start."""

    type = BigInteger()
    inherit_cache = True


@compiles(database_ns, "sqlite")
def _on_sqlite(_element: database_ns, _compiler: Any, **_: Any) -> str:
    return "CAST((julianday('now') - 2440587.5) * 86400000 AS INTEGER) * 1000000"


@compiles(database_ns, "postgresql")
def _on_postgresql(_element: database_ns, _compiler: Any, **_: Any) -> str:
    return "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT) * 1000"
