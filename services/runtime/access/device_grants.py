"""Sign-in of a program through a browser (RFC 8628): it shows a code, a signed-in person approves, it gets a token.

**Conventions.** Only the program has the device code (256 random bits), with which it polls. The person enters the user
code, `BCDF-GHJK`: eight letters without vowels (34 bits), valid for `LASTS_S`. The codes are stored as hashes. The
approver sees the program's name, address and scopes; the token gets those of the scopes that the approver has, and
never `account`. Only a browser session can approve. If that session ends before the token is fetched, the grant ends
too (foreign key). The token is returned once, and its grant is deleted with it.
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
    """A program that requests a token: its name, its address, and the requested scopes."""

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
    """The state of a grant; `token` and its `secret` are set once, after approval."""

    state: State
    token: Token | None = None
    secret: str = ""


def begin_grant(session: Session, request: DeviceRequest) -> DeviceCodes:
    """Create a grant that waits for an approval. Raises `busy` if `MOST_WAITING` grants are waiting."""
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
    """Return the undecided, unexpired grant with this code; case, blanks and dashes are ignored."""
    letters = "".join(letter for letter in user_code.upper() if letter in LETTERS)
    grants = select(DeviceGrant).where(DeviceGrant.user_hash == hash_of(letters))
    row = session.scalars(grants.with_for_update(of=DeviceGrant) if is_locked else grants).one_or_none()
    is_waiting = row and row.expires_ns > now_ns() and row.user_id is None and not row.is_denied
    return row if is_waiting else None


def scopes_for(grant: DeviceGrant, held: frozenset[str]) -> list[str]:
    """Return the token's scopes if a user with the scopes `held` approves."""
    return sorted((frozenset(grant.scopes) & held) - {ACCOUNT})


def approve(grant: DeviceGrant, authority: Authority, session_id: str) -> None:
    """Approve the grant: until the approver's browser session ends, the program can fetch a token of the approver."""
    grant.scopes, grant.user_id = scopes_for(grant, authority.scopes), authority.user_id
    grant.session_id = session_id


def poll(session: Session, device_code: str, token_s: float) -> DevicePoll:
    """Return the state of the grant with this device code; an approved grant becomes a token of `token_s`, once."""
    grants = select(DeviceGrant).where(DeviceGrant.device_hash == hash_of(device_code))
    seen = session.scalars(grants).one_or_none()
    approver_id = seen.user_id if seen else None
    if approver_id:
        lock_user(session, approver_id)  # same lock order as `end_all`
    locked = grants.with_for_update(of=DeviceGrant).execution_options(populate_existing=True)
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
