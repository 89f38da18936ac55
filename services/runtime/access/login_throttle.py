"""Counts of failed sign-ins by name and by address, with exponentially growing waits.

**Conventions.** A try is counted before its password is checked, and uncounted if the password was right. Concurrent
tries therefore have no advantage over sequential ones. Unknown names are counted in the same way. Rows contain hashes
of names and addresses. The counts are in the database, shared by all API processes. With the figures below, a
persistent attacker gets about thirty tries per name in the first hour and four in each later hour. OWASP ASVS 2.2.1
allows at most 100 an hour. A user who mistypes ten times waits a second. It is a wait, never a lock: a token or a
signed-in browser still works, and a day without a wrong password resets all counts.

An address from which a user has signed in is *known* for that user. Tries from a known address are counted by that pair
only, so wrong passwords from other addresses do not block the user. A guesser gains nothing unless they are at such an
address, and then only as many tries as for a name. A new password deletes the user's known addresses.
"""

from dataclasses import dataclass
from hashlib import sha256

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.orm import FailedSignInRow, SignInAddress
from services.runtime.orm.base import now_ns

FREE = {"name": 10, "address": 50, "known": 10}  # a laboratory may have one address
LONGEST_WAIT_S = 900
FORGOTTEN_NS = 86_400 * 10**9
ADDRESSES_KEPT_NS = 90 * 86_400 * 10**9
MOST_ADDRESSES = 20


@dataclass(frozen=True)
class SignInTry:
    """A try of the password of `name` from `address`; `is_known`: the user has signed in from there before."""

    name: str
    address: str
    is_known: bool = False

    @property
    def pair(self) -> str:
        return _key("known", f"{self.name}\n{self.address}")

    @property
    def kind_of(self) -> dict[str, str]:
        """The kind of each counted key."""
        if self.is_known:
            return {self.pair: "known"}
        return {_key("name", self.name): "name", _key("address", self.address): "address"}


def try_at(session: Session, name: str, address: str) -> SignInTry:
    """Return a try at the current time, which is not counted yet."""
    unknown = SignInTry(name, address)
    since_ns = now_ns() - ADDRESSES_KEPT_NS
    known = select(SignInAddress.key).where(SignInAddress.key == unknown.pair, SignInAddress.used_ns > since_ns)
    return SignInTry(name, address, session.scalar(known) is not None)


def count_try(session: Session, tried: SignInTry) -> float:
    """Count the try; return 0.0 if it may continue, otherwise the seconds to wait (then it is not counted)."""
    now, kind_of = now_ns(), tried.kind_of
    insert_new(session, FailedSignInRow, [{"key": key, "failed_ns": now} for key in sorted(kind_of)])
    some = (
        select(FailedSignInRow).where(FailedSignInRow.key.in_(kind_of)).order_by(FailedSignInRow.key).with_for_update()
    )
    rows = session.scalars(some).all()
    if (wait_ns := max(row.blocked_until_ns for row in rows) - now) > 0:
        return min(wait_ns / 1e9, float(LONGEST_WAIT_S))  # bounds the wait after a clock was set back
    for row in rows:
        row.failures = 1 if now - row.failed_ns > FORGOTTEN_NS else row.failures + 1
        row.failed_ns, row.blocked_until_ns = now, now + pause_s(kind_of[row.key], row.failures) * 10**9
    session.flush()
    return 0.0


def take_back(session: Session, tried: SignInTry, user_id: str) -> None:
    """Delete the counts of the name or pair, and uncount this try of the address, which becomes known.

    Call it after a correct password.
    """
    if tried.is_known:
        session.execute(delete(FailedSignInRow).where(FailedSignInRow.key == tried.pair))
    else:
        forgive_name(session, tried.name)
        row = session.get(FailedSignInRow, _key("address", tried.address), with_for_update=True)
        if row is not None:
            row.failures, row.blocked_until_ns = max(0, row.failures - 1), 0
    _remember(session, tried, user_id)


def forgive_name(session: Session, name: str) -> None:
    """Delete the counts of a name, whose new password may be used at once."""
    session.execute(delete(FailedSignInRow).where(FailedSignInRow.key == _key("name", name)))


def forget_addresses(session: Session, user_id: str) -> None:
    """Delete the user's known addresses."""
    session.execute(delete(SignInAddress).where(SignInAddress.user_id == user_id))


def _remember(session: Session, tried: SignInTry, user_id: str) -> None:
    """Store the address as known; the user's `MOST_ADDRESSES` last used addresses are kept."""
    theirs = select(SignInAddress.key).where(SignInAddress.user_id == user_id)
    insert_new(session, SignInAddress, [{"key": tried.pair, "user_id": user_id, "used_ns": now_ns()}])
    session.execute(update(SignInAddress).where(SignInAddress.key == tried.pair).values(used_ns=now_ns()))
    last = theirs.order_by(SignInAddress.used_ns.desc(), SignInAddress.key).limit(MOST_ADDRESSES)
    kept = list(session.scalars(last))
    session.execute(delete(SignInAddress).where(SignInAddress.user_id == user_id, SignInAddress.key.not_in(kept)))


def pause_s(kind: str, failures: int) -> int:
    """Return the wait before the next try after this number of failures: 0, then 1, 2, 4, … up to `LONGEST_WAIT_S`."""
    beyond = failures - FREE[kind]
    return 0 if beyond < 0 else min(LONGEST_WAIT_S, 2 ** min(beyond, 30))


def _key(kind: str, value: str) -> str:
    return sha256(f"{kind} {value}".encode()).hexdigest()
