"""Sign-in of a program by a browser (RFC 8628): it shows a code, a signed-in person approves it, it gets a token.

**Conventions.** The program alone holds the device code (256 random bits), with which it asks; the person types the
user code, `BCDF-GHJK`: eight letters without vowels (34 bits), valid for `LASTS_S`. Both are kept as hashes. Who
approves sees the program's name, address and scopes; the token has those of the scopes that the approver holds, and
never `account`. Only a browser's session approves. If that session ends before the token is fetched, the grant ends too
(the foreign key). The token is returned once, and the row is deleted with it.
"""

from dataclasses import dataclass
from secrets import choice, token_urlsafe
from typing import Literal

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from services.runtime.access.issuing import (
    Authority,
    TokenRequest,
    authority_of_session,
    hash_of,
    issue_token,
    lock_user,
)
from services.runtime.access.roles import ACCOUNT
from services.runtime.orm import DeviceGrant, Token
from services.runtime.orm.base import now_ns
from stone.errors import Refused

LETTERS = "BCDFGHJKLMNPQRSTVWXZ"
CODE_LENGTH = 8
LASTS_S = 600
INTERVAL_S = 5
MOST_WAITING = 10_000
State = Literal["pending", "slow_down", "denied", "unknown", "approved"]


@dataclass(frozen=True)
class DeviceRequest:
    """A program that wants a token: what it calls itself, where it is, and what it wants to do."""

    name: str
    address: str
    scopes: tuple[str, ...]


@dataclass(frozen=True)
class DeviceCodes:
    """The program's secret, and the code that it shows to a person."""

    device_code: str
    user_code: str
    expires_ns: int


@dataclass(frozen=True)
class DevicePoll:
    """How a grant stands; `token` and its `secret` only where it was approved, this once."""

    state: State
    token: Token | None = None
    secret: str = ""


def begin_grant(session: Session, request: DeviceRequest) -> DeviceCodes:
    """A grant that waits for an approval. Raises `busy` where `MOST_WAITING` do already."""
    if (session.scalar(select(func.count()).select_from(DeviceGrant)) or 0) >= MOST_WAITING:
        raise Refused("busy", f"{MOST_WAITING} programs are waiting for an approval; try again in a moment")
    letters = "".join(choice(LETTERS) for _ in range(CODE_LENGTH))
    codes = DeviceCodes(token_urlsafe(32), f"{letters[:4]}-{letters[4:]}", now_ns() + LASTS_S * 10**9)
    grant = DeviceGrant(name=request.name, address=request.address, scopes=sorted(set(request.scopes)))
    grant.device_hash, grant.user_hash = hash_of(codes.device_code), hash_of(letters)
    grant.expires_ns = codes.expires_ns
    session.add(grant)
    session.flush()
    return codes


def find_waiting(session: Session, user_code: str, is_locked: bool = False) -> DeviceGrant | None:
    """The grant of this code, if it has not ended and nobody has decided; case, blanks and dashes do not matter."""
    letters = "".join(one for one in user_code.upper() if one in LETTERS)
    found = select(DeviceGrant).where(DeviceGrant.user_hash == hash_of(letters))
    row = session.scalars(found.with_for_update(of=DeviceGrant) if is_locked else found).one_or_none()
    is_waiting = row and row.expires_ns > now_ns() and row.user_id is None and not row.is_denied
    return row if is_waiting else None


def scopes_for(grant: DeviceGrant, held: frozenset[str]) -> list[str]:
    """What the token would have, approved by somebody who holds these."""
    return sorted((frozenset(grant.scopes) & held) - {ACCOUNT})


def approve(grant: DeviceGrant, authority: Authority, session_id: str) -> None:
    """Approve the grant: until the approver's browser session ends, the program can fetch a token of the approver."""
    grant.scopes, grant.user_id = scopes_for(grant, authority.scopes), authority.user_id
    grant.session_id = session_id


def poll(session: Session, device_code: str, token_s: float) -> DevicePoll:
    """How the grant of this device code stands; an approved one becomes a token of `token_s`, once."""
    found = select(DeviceGrant).where(DeviceGrant.device_hash == hash_of(device_code))
    seen = session.scalars(found).one_or_none()
    approver_id = seen.user_id if seen else None
    if approver_id:
        lock_user(session, approver_id)  # first: `end_all` locks in this order
    locked = found.with_for_update(of=DeviceGrant).execution_options(populate_existing=True)
    row = session.scalars(locked).one_or_none()
    now = now_ns()
    if row is None or row.expires_ns <= now:
        return DevicePoll("unknown")
    is_early, row.polled_ns = now - row.polled_ns < INTERVAL_S * 10**9 * 9 // 10, now
    if row.is_denied:
        session.delete(row)
        return DevicePoll("denied")
    if row.session_id is None or approver_id is None:
        return DevicePoll("slow_down" if is_early else "pending")
    session.delete(row)
    authority = authority_of_session(session, row.session_id, token_s)
    if authority is None:
        return DevicePoll("denied")
    scopes = frozenset(row.scopes) & authority.scopes
    if not scopes:
        return DevicePoll("denied")
    token, secret = issue_token(session, authority, TokenRequest(row.name, scopes))
    return DevicePoll("approved", token, secret)
