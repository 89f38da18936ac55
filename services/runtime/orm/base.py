"""The ORM base class, column types and ids.

**Conventions.** An id is 32 hex digits: twelve of a millisecond clock, four of a counter, sixteen random; so rows sort
by age and ids cannot be guessed. Times are integer nanoseconds since 1970, `<verb>_ns`. Every constraint has a name, so
that migrations can refer to it on both databases.
"""

import time
from secrets import token_hex
from threading import Lock
from typing import Annotated, Any, ClassVar

from sqlalchemy import JSON, BigInteger, Index, MetaData, String, TextClause, text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

from stone_base.label_quality import LabelQuality

Id = Annotated[str, mapped_column(String(32))]
Ns = Annotated[int, mapped_column(BigInteger)]
Bytes = Annotated[int, mapped_column(BigInteger)]
Count = Annotated[int, mapped_column(BigInteger)]
Record = Annotated[dict[str, Any], mapped_column(JSON)]

NAMING = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "ck": "ck_%(table_name)s_%(constraint_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}


class Base(DeclarativeBase):
    metadata: ClassVar[MetaData] = MetaData(naming_convention=NAMING)


class WithQuality:
    """The columns of `LabelQuality` (`stone_base/label_quality.py`), for label sets and rows that copy them."""

    held_out_recall: Mapped[float | None]
    held_out_m: Mapped[float | None]
    gravest_code: Mapped[str | None] = mapped_column(String(16))
    gravest_severity: Mapped[str | None] = mapped_column(String(8))

    @property
    def quality(self) -> LabelQuality:
        return LabelQuality(self.held_out_recall, self.held_out_m, self.gravest_code, self.gravest_severity)


def now_ns() -> int:
    """Return the wall clock, for people and for expiry in days; no lease and no order of work depends on it."""
    return time.time_ns()


class _Ids:
    """Ids of this process: a clock that never runs backwards, a counter within its millisecond, 64 random bits."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._last = 0

    def next(self) -> str:
        with self._lock:
            self._last = max(self._last + 1, (time.time_ns() // 1_000_000) << 16)
            return f"{self._last:016x}{token_hex(8)}"


_IDS = _Ids()


def new_id() -> str:
    """Return a new id: sortable by age, not guessable. Ids created by one process sort in their order."""
    return _IDS.next()


def partial_index(name: str, where: str, *columns: str | TextClause) -> Index:
    """Return an index of the rows that satisfy `where`, in literals that both databases understand."""
    return Index(name, *columns, sqlite_where=text(where), postgresql_where=text(where))
