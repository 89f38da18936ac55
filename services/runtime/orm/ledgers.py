"""ORM models of append-only ledgers: quotas, the audit log; and stored idempotent replies."""

from typing import Any

from sqlalchemy import JSON, BigInteger, ForeignKey, Index, Integer, LargeBinary, String
from sqlalchemy.orm import Mapped, mapped_column

from services.runtime.orm.base import Base, Id, Ns, Record, new_id, now_ns


class QuotaEntry(Base):
    """`amount` bytes reserved (positive) or released (negative) by an owner for a subject; the balance is the sum."""

    __tablename__ = "quota_ledger"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    owner_id: Mapped[Id] = mapped_column(ForeignKey("users.id"))
    kind: Mapped[str] = mapped_column(String(16))
    amount: Mapped[int] = mapped_column(BigInteger)
    subject_id: Mapped[str] = mapped_column(String(64), index=True)
    reason: Mapped[str] = mapped_column(String(64))
    created_ns: Mapped[Ns] = mapped_column(default=now_ns)

    # With the amounts in the index, a balance is summed without reading rows.
    __table_args__ = (Index("ix_quota_ledger_owner_amount", "owner_id", "amount"),)


class AuditEntry(Base):
    """`hash` = sha256 over the previous entry's hash and this entry: it reveals a removed or changed line."""

    __tablename__ = "audit_log"
    number: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    actor_id: Mapped[str] = mapped_column(String(32), default="", index=True)
    actor: Mapped[str] = mapped_column(String(64))
    act: Mapped[str] = mapped_column(String(64))
    subject_id: Mapped[str] = mapped_column(String(64), default="", index=True)
    reason: Mapped[str] = mapped_column(String(512), default="")
    facts: Mapped[Record] = mapped_column(JSON, default=dict)
    request_id: Mapped[str] = mapped_column(String(64), default="")
    logged_ns: Mapped[Ns] = mapped_column(default=now_ns)
    hash: Mapped[str] = mapped_column(String(64), unique=True)

    __table_args__ = (
        Index("ix_audit_log_act_number", "act", "number"),
        Index("ix_audit_log_actor_number", "actor", "number"),
    )


class AuditAnchor(Base):
    """The audit log starts after the line of this number, whose hash its first line continues."""

    __tablename__ = "audit_anchors"
    number: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    hash: Mapped[str] = mapped_column(String(64))
    cut_ns: Mapped[Ns] = mapped_column(default=now_ns)


class IdempotentReply(Base):
    """The reply to a request with an Idempotency-Key; `status` is 0 while the first request is in progress.

    `route` is the sha256 of the path and of the caller's rights.
    """

    __tablename__ = "idempotent_replies"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    user_id: Mapped[Id] = mapped_column(ForeignKey("users.id", ondelete="CASCADE"))
    route: Mapped[str] = mapped_column(String(128))
    key: Mapped[str] = mapped_column(String(128))
    request_sha256: Mapped[str] = mapped_column(String(64))
    status: Mapped[int] = mapped_column(default=0)
    headers: Mapped[Record] = mapped_column(JSON, default=dict)
    body: Mapped[bytes] = mapped_column(LargeBinary, default=b"")
    created_ns: Mapped[Ns] = mapped_column(default=now_ns, index=True)

    __table_args__ = (Index("uq_idempotent_replies_user_route_key", "user_id", "route", "key", unique=True),)


# ORM model of garbage collection holds.


class GcHoldRow(Base):
    """Until `until_ns`, on the database's clock, no object of the store is deleted.

    The holder renews it regularly; the hold of a dead holder expires.
    """

    __tablename__ = "gc_holds"
    id: Mapped[Id] = mapped_column(primary_key=True, default=new_id)
    reason: Mapped[str] = mapped_column(String(128))
    until_ns: Mapped[Ns] = mapped_column(index=True)


# ORM models of the store's scrub, and of the faults that it or another reader detected.


class StoreScrub(Base):
    """The current pass through all blobs, one row: `objects` and `size_bytes` are read, up to `after_sha256`.

    `passed_ns` is the end of the last full pass, null before the first.
    """

    __tablename__ = "store_scrub"
    id: Mapped[int] = mapped_column(Integer, primary_key=True, autoincrement=False)
    after_sha256: Mapped[str] = mapped_column(String(64), default="")
    objects: Mapped[int] = mapped_column(BigInteger, default=0)
    size_bytes: Mapped[int] = mapped_column(BigInteger, default=0)
    begun_ns: Mapped[Ns] = mapped_column(default=now_ns)
    passed_ns: Mapped[Ns | None]


class StoreFault(Base):
    """A blob whose object differs from its row; no foreign key, because the fault would keep the blob.

    `fault` is one of `services/runtime/store/faults.py`.
    """

    __tablename__ = "store_faults"
    sha256: Mapped[str] = mapped_column(String(64), primary_key=True)
    fault: Mapped[str] = mapped_column(String(16))
    found_ns: Mapped[Ns] = mapped_column(default=now_ns)


# ORM models of telemetry: process counters, chore times, measured figures.


class CounterRow(Base):
    """The counters of one process, `told_ns` on the database's clock; one row is the sum of folded rows."""

    __tablename__ = "process_counters"
    id: Mapped[Id] = mapped_column(primary_key=True)
    counts: Mapped[dict[str, Any]] = mapped_column(JSON, default=dict)
    told_ns: Mapped[Ns] = mapped_column(index=True)


class ChoreRow(Base):
    """The time when any sweeper last did a chore, on the database's clock."""

    __tablename__ = "chores"
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    done_ns: Mapped[Ns]


class FigureRow(Base):
    """A number that is expensive to compute, and its time."""

    __tablename__ = "figures"
    name: Mapped[str] = mapped_column(String(64), primary_key=True)
    value: Mapped[int] = mapped_column(BigInteger)
    measured_ns: Mapped[Ns]
