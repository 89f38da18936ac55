"""The audit log: actor, act, subject and reason, in append-only lines chained by hashes.

**Conventions.** `hash` = sha256 of the canonical JSON (sorted keys, no spaces, UTF-8) of the line with `previous`, the
hash before it ("" for the first); numbers count from 1. An act and its line share one transaction. The line is
written last, just before the commit, under a lock that every writer takes, so two writers at once add two links to one
chain. The lock is held briefly and is the last one taken, so it causes no deadlock. A noted head reveals a removed tail
(`GET /admin/audit-log/verification`, and the process's own log).
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import structlog
from sqlalchemy import event, select, text
from sqlalchemy.orm import Session

from services.runtime.orm import AuditAnchor, AuditEntry
from services.runtime.orm.base import now_ns

LOCK = 0x4155444954  # "AUDIT": key of the advisory lock shared by all processes of the platform
AT_A_TIME = 500
PENDING = "audit_entries"
PLATFORM = "platform"
"""The actor of acts that a setting causes, without a person."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class AuditHead:
    """The last line of the chain; number 0 and an empty hash if there is none."""

    number: int
    hash: str


def append(session: Session, entry: AuditEntry, facts: Mapping[str, Any] | None = None) -> None:
    """Add a line to the log with this transaction's commit. `facts` is a small JSON object without secrets."""
    entry.facts, entry.logged_ns = json.loads(canonical(facts or {})), now_ns()
    if PENDING not in session.info:
        session.info[PENDING] = []
        event.listen(session, "before_commit", _write)
    session.info[PENDING].append(entry)


def append_own(session: Session, act: str, subject_id: str, facts: Mapping[str, Any]) -> None:
    """Add a line for an act that the platform performs automatically, by its settings."""
    entry = AuditEntry(act=act, subject_id=subject_id, reason="", actor_id="", actor=PLATFORM, request_id="")
    append(session, entry, facts)


def verify(session: Session) -> int | None:
    """Return the number of the first line that does not follow from its predecessor; None if all do.

    The check starts at the anchor of the log's last cut.
    """
    begin = cut(session)
    previous, expected = begin.hash, begin.number + 1
    for entry in _all(session):
        if entry.number != expected or entry.hash != hash_of(entry, previous):
            return expected
        previous, expected = entry.hash, expected + 1
    return None


def head(session: Session) -> AuditHead:
    last = session.scalars(select(AuditEntry).order_by(AuditEntry.number.desc()).limit(1)).one_or_none()
    return AuditHead(last.number, last.hash) if last else cut(session)


def cut(session: Session) -> AuditHead:
    """Return the last line that retention deleted (`services/runtime/access/retention.py`), or number 0 if none was."""
    anchor = session.scalars(select(AuditAnchor).order_by(AuditAnchor.number.desc()).limit(1)).one_or_none()
    return AuditHead(anchor.number, anchor.hash) if anchor else AuditHead(0, "")


def hash_of(entry: AuditEntry, previous: str) -> str:
    """Return the hash that links this line to `previous`."""
    names = ("number", "actor_id", "actor", "act", "subject_id", "reason", "facts", "request_id", "logged_ns")
    line = {name: getattr(entry, name) for name in names} | {"previous": previous}
    return sha256(canonical(line).encode()).hexdigest()


def canonical(value: Mapping[str, Any]) -> str:
    """Return the canonical JSON text of a value. Raises `ValueError` for NaN and infinities."""
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def _write(session: Session) -> None:
    entries: list[AuditEntry] = session.info[PENDING]
    if not entries:
        return
    session.flush()
    if session.get_bind().dialect.name == "postgresql":
        session.execute(text("SELECT pg_advisory_xact_lock(:number)"), {"number": LOCK})
    # SQLite needs no lock: a writing transaction holds the only write lock from its BEGIN on.
    last = head(session)
    for entry in entries:
        entry.number = last.number + 1
        entry.hash = hash_of(entry, last.hash)
        last = AuditHead(entry.number, entry.hash)
    session.add_all(entries)
    log.info("audited", number=last.number, hash=last.hash, acts=[entry.act for entry in entries])
    session.info[PENDING] = []


def _all(session: Session) -> Iterator[AuditEntry]:
    after = 0
    while True:
        page = select(AuditEntry).where(AuditEntry.number > after).order_by(AuditEntry.number).limit(AT_A_TIME)
        entries = session.scalars(page).all()
        if not entries:
            return
        yield from entries
        after = entries[-1].number
        session.expunge_all()
