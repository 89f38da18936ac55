"""Rows of every table, in such numbers and states as somebody would leave who wants the sweeper to be slow.

**Conventions.** Everything is as old as it can be, so that it is swept. Rows refer to nothing: what refers is looked up
by index, and whether a chore reads more where there is more is all that is asked here. A table of which strangers make
no rows, or whose chores count every row for a reason, is in `NOT_STRANGERS`; a new one is flooded without being named.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from sqlalchemy import JSON, Boolean, Column, Engine, Float, Integer, LargeBinary, Table, create_engine, event, text

from services.runtime.orm import Base
from services.runtime.platform import Platform

LATER_NS = 2**62
EVERY_STEPS = 20
NOT_STRANGERS = {
    "workers": "a row for each of our processes",
    "process_counters": "a row for each of our processes",
    "chores": "a row for each chore",
    "figures": "a row for each figure",
    "store_scrub": "one row",
    "store_faults": "a row for each object that decayed",
    "queues": "three",
    "gc_holds": "a row for each backup under way",
    "audit_anchors": "a row for each cut of the audit log",
}
PARTICULAR: dict[str, tuple[dict[str, Any], ...]] = {
    "uploads": (
        {"state": "open", "expires_ns": LATER_NS},
        {"state": "open"},
        {"state": "complete", "expires_ns": LATER_NS},
        {"state": "complete"},
        {"state": "terminated"},
    ),
    # Those that are queued or scored by a run are as many as were paid for with a scoring or a check of the day.
    "submissions": (
        {"state": "draft"},
        {"state": "invalid", "upload_id": None},
        {"state": "invalid"},
        {"state": "scored", "withdrawn_ns": None},
        {"state": "scored", "withdrawn_ns": None, "upload_id": None},
    ),
    # Those that run are as many as there are workers; those that are ready are counted up to a number of their own.
    "jobs": ({"state": "succeeded", "queue": "labeler"}, {"state": "queued", "queue": "labeler", "needs_left": 1}),
    "notification_events": ({"spread_ns": None}, {}),
    "notification_deliveries": ({"state": "waiting"}, {"state": "queued"}, {"state": "delivered"}),
    "upload_parts": ({"offset_bytes": 0}, {"offset_bytes": 5}),
    "loose_objects": ({"is_condemned": False}, {"is_condemned": True}),
}


@dataclass
class Cost:
    """What something asked of the database: statements, and the steps of SQLite's machine, in units of 20.

    A step is a row looked at, compared, written: the same number on every machine.
    """

    statements: int = 0
    steps: int = 0


def flood(platform: Platform, rows: int) -> None:
    """So many rows in every table, and an empty file for each upload."""
    engine = create_engine(platform.settings.database_url)  # one that minds no foreign key
    with engine.begin() as connection:
        connection.execute(text("PRAGMA synchronous=OFF"))
        for table in Base.metadata.sorted_tables:
            if table.name not in NOT_STRANGERS:
                connection.execute(table.insert(), [_row(table, number) for number in range(rows)])
    engine.dispose()
    folder = platform.settings.uploads_folder
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(rows):
        (folder / f"{number:032x}").touch()


@contextmanager
def cost_of(engine: Engine) -> Iterator[Cost]:
    """What is asked of SQLite meanwhile."""
    cost = Cost()

    def watch(connection: Any, _record: object, _proxy: object) -> None:
        connection.set_progress_handler(step, EVERY_STEPS)

    def step() -> int:
        cost.steps += 1
        return 0

    def count(*_: object) -> None:
        cost.statements += 1

    event.listen(engine, "checkout", watch)
    event.listen(engine, "after_cursor_execute", count)
    try:
        yield cost
    finally:
        event.remove(engine, "checkout", watch)
        event.remove(engine, "after_cursor_execute", count)
        engine.dispose()


def _row(table: Table, number: int) -> dict[str, Any]:
    particular = PARTICULAR.get(table.name, ({},))
    row = {column.name: _value(column, number) for column in table.columns}
    return row | particular[number % len(particular)]


def _value(column: Column[Any], number: int) -> Any:
    """One of the column's type that no other row has; times are long over."""
    if isinstance(column.type, Boolean):
        return False
    if isinstance(column.type, JSON):
        return json.loads("{}")
    if isinstance(column.type, LargeBinary):
        return b""
    if isinstance(column.type, Float):
        return 0.5
    if isinstance(column.type, Integer):
        is_number = column.primary_key and not column.name.endswith("bytes")
        return number + 1 if is_number or column.name.endswith("_ns") else 1
    if column.name == "object_key":
        return f"blobs/{number % 256:02x}/{number:064x}.00000000"
    name = f"{number:0{min(getattr(column.type, 'length', None) or 32, 32)}x}"
    refers = [key for key in column.foreign_keys if key.column.table.name != "users"]
    return f"f{name[1:]}" if refers else name
