"""Transactions read from PostgreSQL's log, each with its statements and purpose.

**Conventions.** The server logs every statement (`LOGGING`); each line begins with the program's name (`PGAPPNAME`) and
the server process. A statement outside BEGIN and COMMIT is a transaction of its own. BEGIN, COMMIT and ROLLBACK are
statements too: each is a round trip.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

LOGGING = {"log_statement": "all", "log_line_prefix": "%a %p ", "log_min_messages": "log"}
_LINE = re.compile(r"(?P<program>\S*) (?P<server>\d+) (?P<level>[A-Z]+): +(?P<said>.*)")
_STATEMENT = re.compile(r"(?:statement|execute [^:]+): (?P<sql>.*)", re.DOTALL)
ENDS = ("COMMIT", "ROLLBACK")
PURPOSES: tuple[tuple[str, str], ...] = (
    ("claim", r"INSERT INTO job_attempts"),
    ("end of a job", r"UPDATE job_attempts"),
    ("heartbeat", r"heartbeats=\(?(jobs\.)?heartbeats"),
    ("log lines", r"INSERT INTO job_lines"),
    ("start of a run", r"SELECT jobs\.traceparent|started_ns=\S+ WHERE jobs\.id = \S+ AND jobs\.queue"),
    ("claim of nothing", r"FROM queues"),
    ("presence", r"UPDATE workers|INTO workers|counter_rows"),
    ("liveness of a connection", r"^;?$"),
)
OTHER = "work of the job"


@dataclass(frozen=True)
class LoggedTransaction:
    """One connection's statements from BEGIN to its end."""

    program: str
    statements: tuple[str, ...]

    @property
    def purpose(self) -> str:
        """The first of `PURPOSES` that matches any of its statements, else the work itself."""
        inner = [sql for sql in self.statements if sql not in ("BEGIN", *ENDS)]
        purposes = (name for name, sign in PURPOSES if any(re.search(sign, sql) for sql in inner))
        return next(purposes, OTHER)


def transactions(lines: Iterable[str]) -> Iterator[LoggedTransaction]:
    """Yield every transaction that ended within these lines."""
    opened: dict[str, list[str]] = {}
    for program, server, sql in _statements(lines):
        if sql.startswith("BEGIN"):
            opened[server] = [sql]
        elif server in opened:
            opened[server].append(sql)
            if sql in ENDS:
                yield LoggedTransaction(program, tuple(opened.pop(server)))
        else:
            yield LoggedTransaction(program, (sql,))


def _statements(lines: Iterable[str]) -> Iterator[tuple[str, str, str]]:
    """Yield (program, server process, SQL) of each statement; continuation lines begin with a tab."""
    held: tuple[str, str, str] | None = None
    for line in lines:
        if line.startswith("\t") and held is not None:
            held = (*held[:2], f"{held[2]} {line.strip()}")
            continue
        if held is not None:
            yield held
        held = _statement(line.rstrip("\n"))
    if held is not None:
        yield held


def _statement(line: str) -> tuple[str, str, str] | None:
    match = _LINE.fullmatch(line)
    sql = _STATEMENT.fullmatch(match["said"]) if match and match["level"] == "LOG" else None
    return None if match is None or sql is None else (match["program"], match["server"], sql["sql"].strip())
