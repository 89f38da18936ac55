"""Rows of worker processes: what each tells of itself, of any number of processes in one statement."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from sqlalchemy import case
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.orm import Worker


@dataclass(frozen=True)
class ProcessPresence:
    """A process and what it and its machine hold, as in the row of that name."""

    name: str
    queues: str
    started_ns: int
    held_bytes: int | None
    memory_free_bytes: int | None
    memory_bytes: int | None
    disk_free_bytes: int | None
    disk_bytes: int | None


def write_presence(session: Session, present: Sequence[ProcessPresence]) -> None:
    """Insert or update their rows; a row of another process, whose pid came round again, begins anew."""
    ordered = sorted(present, key=lambda one: one.name)  # one order, in which no two sessions wait for each other
    rows = [{**asdict(one), "beat_ns": database_ns(), "beats": 1} for one in ordered]
    dialect = sqlite if session.get_bind().dialect.name == "sqlite" else postgresql
    inserted = dialect.insert(Worker).values(rows)
    told = {name: inserted.excluded[name] for name in rows[0] if name not in ("name", "beats")}
    beats = case((Worker.started_ns == inserted.excluded.started_ns, Worker.beats + 1), else_=1)
    session.execute(inserted.on_conflict_do_update(index_elements=[Worker.name], set_={**told, "beats": beats}))
