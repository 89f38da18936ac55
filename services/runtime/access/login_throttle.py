"""Failed sign-in counts by name and by address, with exponentially growing waits.

**Conventions.** A try is counted before its password is looked at and taken back when it was right, so that many at
once buy no more than one after another; names that nobody has are counted alike. Rows hold hashes of names and
addresses. The counts are in the database: every process of the API sees the same. With the figures below somebody who
never stops gets some thirty tries at a name in the first hour and four in each one after (OWASP ASVS 2.2.1: at most 100
an hour), while who mistypes ten times waits a second. It is a wait, never a lock: an administrator's password by token
or a signed-in browser works meanwhile, and a day without a wrong password forgets all of it.

An address from which a name has signed in is *known* for it: what is tried there is counted by that pair alone, so that
nobody else's wrong passwords keep its user out, wherever they come from. It gives a guesser nothing unless they are at
such an address themselves, and then as many tries as a name has. A new password forgets a user's addresses.
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
    """A try at the password of `name` from `address`; `is_known`: that user signed in from there before."""

    name: str
    address: str
    is_known: bool = False

    @property
    def pair(self) -> str:
        return _key("known", f"{self.name}\n{self.address}")

    @property
    def kind_of(self) -> dict[str, str]:
        """What it is counted by: the kind of each key."""
        if self.is_known:
            return {self.pair: "known"}
        return {_key("name", self.name): "name", _key("address", self.address): "address"}


def try_at(session: Session, name: str, address: str) -> SignInTry:
    """A try of now, of which nothing is counted yet."""
    unknown = SignInTry(name, address)
    since_ns = now_ns() - ADDRESSES_KEPT_NS
    known = select(SignInAddress.key).where(SignInAddress.key == unknown.pair, SignInAddress.used_ns > since_ns)
    return SignInTry(name, address, session.scalar(known) is not None)


def count_try(session: Session, tried: SignInTry) -> float:
    """Count the try; 0.0 where it may go on, else the seconds to wait, and nothing counts."""
    now, kind_of = now_ns(), tried.kind_of
    insert_new(session, FailedSignInRow, [{"key": key, "failed_ns": now} for key in sorted(kind_of)])
    some = (
        select(FailedSignInRow).where(FailedSignInRow.key.in_(kind_of)).order_by(FailedSignInRow.key).with_for_update()
    )
    rows = session.scalars(some).all()
    if (wait_ns := max(row.blocked_until_ns for row in rows) - now) > 0:
        return min(wait_ns / 1e9, float(LONGEST_WAIT_S))  # a clock that was set back keeps nobody out for longer
    for row in rows:
        row.failures = 1 if now - row.failed_ns > FORGOTTEN_NS else row.failures + 1
        row.failed_ns, row.blocked_until_ns = now, now + pause_s(kind_of[row.key], row.failures) * 10**9
    session.flush()
    return 0.0


def take_back(session: Session, tried: SignInTry, user_id: str) -> None:
    """The password was right: all is forgotten of the name or pair, and this one try of an address, which is known
    from now on."""
    if tried.is_known:
        session.execute(delete(FailedSignInRow).where(FailedSignInRow.key == tried.pair))
    else:
        forgive_name(session, tried.name)
        row = session.get(FailedSignInRow, _key("address", tried.address), with_for_update=True)
        if row is not None:
            row.failures, row.blocked_until_ns = max(0, row.failures - 1), 0
    _remember(session, tried, user_id)


def forgive_name(session: Session, name: str) -> None:
    """Whoever has a new password may use it at once."""
    session.execute(delete(FailedSignInRow).where(FailedSignInRow.key == _key("name", name)))


def forget_addresses(session: Session, user_id: str) -> None:
    """No address is known for the user any more."""
    session.execute(delete(SignInAddress).where(SignInAddress.user_id == user_id))


def _remember(session: Session, tried: SignInTry, user_id: str) -> None:
    """The address is known; of a user's addresses the `MOST_ADDRESSES` used last are."""
    theirs = select(SignInAddress.key).where(SignInAddress.user_id == user_id)
    insert_new(session, SignInAddress, [{"key": tried.pair, "user_id": user_id, "used_ns": now_ns()}])
    session.execute(update(SignInAddress).where(SignInAddress.key == tried.pair).values(used_ns=now_ns()))
    last = theirs.order_by(SignInAddress.used_ns.desc(), SignInAddress.key).limit(MOST_ADDRESSES)
    kept = list(session.scalars(last))
    session.execute(delete(SignInAddress).where(SignInAddress.user_id == user_id, SignInAddress.key.not_in(kept)))


def pause_s(kind: str, failures: int) -> int:
    """The wait before the next try after so many wrong ones: 0, then 1, 2, 4, … up to `LONGEST_WAIT_S`."""
    beyond = failures - FREE[kind]
    return 0 if beyond < 0 else min(LONGEST_WAIT_S, 2 ** min(beyond, 30))


def _key(kind: str, value: str) -> str:
    return sha256(f"{kind} {value}".encode()).hexdigest()
