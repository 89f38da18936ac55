"""Stored replies of idempotent requests: reserved, marked as done, replayed, deleted after a day.

**Conventions.** `status` of a row: 0, being worked on; 1, took effect and is being answered; 2, took effect and its
answer is not kept (it holds a secret, or is too large); else the answer's own. The step from 0 to 1 is part of the very
transaction that takes effect, so what a crash leaves behind is known once the lease has run out: after 0 nothing
happened and the request may be worked on again; after 1 it must not be.
"""

from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass

from sqlalchemy import delete, event, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from api.errors import KeyReusedError, ReplyNotKeptError, RequestInFlightError
from services.runtime.database.transactions import Database
from services.runtime.orm import IdempotentReply
from services.runtime.orm.base import now_ns

IN_WORK, TOOK_EFFECT, NOT_KEPT = 0, 1, 2
KEPT_NS = 24 * 3600 * 10**9

working_for: ContextVar[str] = ContextVar("idempotent_reply", default="")


@dataclass(frozen=True)
class IdempotentRequest:
    """A request as its caller identified it; `lease_ns` is longer than any such request lasts."""

    user_id: str
    route: str
    key: str
    sha256: str
    lease_ns: int


@dataclass(frozen=True)
class StoredReply:
    """An answer that was kept."""

    status: int
    headers: Mapping[str, str]
    body: bytes


def reserve(database: Database, asked: IdempotentRequest) -> StoredReply | str:
    """The answer kept for this key, or the id of the row that is now ours to work for.

    Raises `KeyReusedError`, `RequestInFlightError`, `ReplyNotKeptError`.
    """
    fresh = IdempotentReply(user_id=asked.user_id, route=asked.route, key=asked.key, request_sha256=asked.sha256)
    try:
        with database.transaction() as session:
            old = IdempotentReply.created_ns < now_ns() - KEPT_NS
            session.execute(delete(IdempotentReply).where(IdempotentReply.user_id == asked.user_id, old))
            session.add(fresh)
            session.flush()
            return fresh.id
    except IntegrityError:
        return _resume(database, asked)


def keep(database: Database, row_id: str, reply: StoredReply | None) -> None:
    """Keep the answer; without one, note that there was an effect."""
    values: dict[str, object] = {"status": NOT_KEPT}
    if reply is not None:
        values = {"status": reply.status, "headers": dict(reply.headers), "body": reply.body}
    with database.transaction() as session:
        session.execute(update(IdempotentReply).where(IdempotentReply.id == row_id).values(**values))


def release(database: Database, row_id: str) -> None:
    """Forget the request: it was refused, and the next one with this key is worked on."""
    with database.transaction() as session:
        session.execute(delete(IdempotentReply).where(IdempotentReply.id == row_id))


def give_up(database: Database, row_id: str) -> None:
    """Forget a request that ended in a fault, unless it took effect: its commit may only not have been heard of."""
    mine = IdempotentReply.id == row_id
    with database.transaction() as session:
        session.execute(delete(IdempotentReply).where(mine, IdempotentReply.status == IN_WORK))
        session.execute(update(IdempotentReply).where(mine).values(status=NOT_KEPT))


def _resume(database: Database, asked: IdempotentRequest) -> StoredReply | str:
    """The reaction to a key that is known already."""
    with database.transaction() as session:
        same = (IdempotentReply.user_id == asked.user_id, IdempotentReply.route == asked.route)
        known = select(IdempotentReply).where(*same, IdempotentReply.key == asked.key).with_for_update()
        row = session.scalars(known).one_or_none()
        if row is None:  # it failed and was forgotten in this very moment
            raise RequestInFlightError()
        if row.request_sha256 != asked.sha256:
            raise KeyReusedError()
        if row.status == NOT_KEPT:
            raise ReplyNotKeptError()
        if row.status not in (IN_WORK, TOOK_EFFECT):
            return StoredReply(row.status, row.headers, row.body)
        if abs(now_ns() - row.created_ns) < asked.lease_ns:
            raise RequestInFlightError()
        if row.status == TOOK_EFFECT:
            raise ReplyNotKeptError()
        row.created_ns = now_ns()  # its process died before anything happened
        return row.id


@event.listens_for(Session, "before_commit")
def _mark(session: Session) -> None:
    """Mark the request's key as done, within the request's own transaction."""
    row_id = working_for.get()
    if row_id:
        mine = update(IdempotentReply).where(IdempotentReply.id == row_id, IdempotentReply.status == IN_WORK)
        session.execute(mine.values(status=TOOK_EFFECT), execution_options={"synchronize_session": False})
