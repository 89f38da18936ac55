"""ORM models of telemetry: process counters, chore times, measured figures."""

from typing import Any

from sqlalchemy import JSON, BigInteger, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Id, Ns


class CounterRow(Base):
    """The counters of one process, `told_ns` by the database's clock; one row is the sum of those folded."""

    __tablename__ = "process_counters"
    id: Mapped[Id] = mapped_column(primary_key=True)
    counts: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    told_ns: Mapped[Ns] = mapped_column(index=True)


class ChoreRow(Base):
    """When a chore of the sweeper was last done, by the database's clock, whichever sweeper did it."""

    __tablename__ = "chores"
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    done_ns: Mapped[Ns]


class FigureRow(Base):
    """A number that takes long to find out, and when it was found out."""

    __tablename__ = "figures"
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    value: Mapped[int] = mapped_column(BigInteger)
    measured_ns: Mapped[Ns]
