"""Query plans: every statement of a query is recorded, and PostgreSQL explains it.

**Conventions.** A fault is a scan of a whole large table, or of a whole index without a LIMIT. Rows read are the rows
returned and discarded by scans, over all loops. Explaining runs the statement; it is rolled back.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy import Connection, Engine, event

SCANS = ("Seq Scan", "Index Scan", "Index Only Scan", "Bitmap Heap Scan")
EXPLAINED = ("SELECT", "WITH", "UPDATE", "DELETE")


@dataclass
class Statement:
    """A statement as sent, and its latency."""

    sql: str
    parameters: Any
    lasted_s: float = 0.0

    @property
    def is_explained(self) -> bool:
        return self.sql.lstrip().upper().startswith(EXPLAINED)


@dataclass(frozen=True)
class StatementPlan:
    """`faults` describe full scans; `rows_read` is None if the statement was not run."""

    sql: str
    faults: tuple[str, ...]
    indexes: tuple[str, ...]
    rows_read: int | None


@contextmanager
def record_statements(engine: Engine) -> Iterator[list[Statement]]:
    """Yield the list of statements that any session of `engine` executes during the block, in order."""
    statements: list[Statement] = []
    begun_s: dict[int, float] = {}

    def begin(_connection: Any, cursor: Any, sql: str, parameters: Any, _context: Any, _many: bool) -> None:
        begun_s[id(cursor)] = time.perf_counter()

    def end(_connection: Any, cursor: Any, sql: str, parameters: Any, _context: Any, many: bool) -> None:
        lasted_s = time.perf_counter() - begun_s.pop(id(cursor), time.perf_counter())
        statements.append(Statement(sql, parameters[0] if many else parameters, lasted_s))

    event.listen(engine, "before_cursor_execute", begin)
    event.listen(engine, "after_cursor_execute", end)
    try:
        yield statements
    finally:
        event.remove(engine, "before_cursor_execute", begin)
        event.remove(engine, "after_cursor_execute", end)


def explained(
    connection: Connection, statement: Statement, large: frozenset[str], *, is_run: bool = True
) -> StatementPlan:
    """Return the plan of a statement; with `is_run` the statement is executed for it. The caller rolls back."""
    options = "ANALYZE, BUFFERS, FORMAT JSON" if is_run else "FORMAT JSON"
    plan = connection.exec_driver_sql(f"EXPLAIN ({options}) {statement.sql}", statement.parameters).scalar_one()
    scans = list(_scans(plan[0]["Plan"], is_ended=False))
    faults = tuple(dict.fromkeys(fault for node, ended in scans if (fault := _fault(node, ended, large))))
    indexes = tuple(dict.fromkeys(node["Index Name"] for node, _ in scans if "Index Name" in node))
    return StatementPlan(statement.sql, faults, indexes, sum(_rows(node) for node, _ in scans) if is_run else None)


def large_tables(connection: Connection, rows: int = 10_000) -> frozenset[str]:
    """Return the tables with at least `rows` rows, by the statistics."""
    query = f"SELECT relname FROM pg_class WHERE relkind = 'r' AND reltuples >= {rows}"
    return frozenset(connection.exec_driver_sql(query).scalars())


def _scans(node: dict[str, Any], *, is_ended: bool) -> Iterator[tuple[dict[str, Any], bool]]:
    """Yield every scan with whether a LIMIT above ends it early: no step between reads it to its end first."""
    if node["Node Type"] in (*SCANS, "Bitmap Index Scan"):
        yield node, is_ended
    for child in node.get("Plans", ()):
        kind = node["Node Type"]
        passes = kind in ("Limit", "LockRows", "Result", "Subquery Scan", "Append", "Nested Loop", "ModifyTable")
        reads_all = kind in ("Sort", "Aggregate", "Hash", "Hash Join", "WindowAgg", "Unique")
        yield from _scans(child, is_ended=kind == "Limit" or (is_ended and passes and not reads_all))


def _fault(node: dict[str, Any], is_ended: bool, large: frozenset[str]) -> str:
    table = node.get("Relation Name", "")
    if table not in large:
        return ""
    if node["Node Type"] == "Seq Scan":
        return f"reads all of {table}"
    if node["Node Type"] in ("Index Scan", "Index Only Scan") and "Index Cond" not in node and not is_ended:
        return f"reads all of {node['Index Name']}"
    return ""


def _rows(node: dict[str, Any]) -> int:
    if node["Node Type"] == "Bitmap Index Scan":  # counted with the scan that fetches its rows
        return 0
    thrown = node.get("Rows Removed by Filter", 0) + node.get("Rows Removed by Index Recheck", 0)
    return round(float((node.get("Actual Rows", 0) + thrown) * node.get("Actual Loops", 1)))
