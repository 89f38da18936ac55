"""Failed sign-in counts by name and by address, with exponentially growing waits.

**Conventions.** A try is counted before its password is looked at and taken back when it was right, so that many at
once buy no more than one after another; names that nobody has are counted alike. Rows hold hashes of names and
addresses. The counts are in the database: every process of the API sees the same. With the figures below somebody who
never stops gets some thirty tries at a name in the first hour and four in each one after (OWASP ASVS 2.2.1: at most 100
an hour), while who mistypes ten times waits a second. It is a wait, never a lock: an administrator's password by token
or a signed-in browser works meanwhile, and a day without a wrong password forgets all of it.
"""

from collections.abc import Mapping
from hashlib import sha256

from sqlalchemy import delete, select
from sqlalchemy.orm import Session

from services.runtime.database.inserts import insert_new
from services.runtime.orm import FailedSignInRow
from services.runtime.orm.base import now_ns

FREE = {"name": 10, "address": 50}  # a laboratory may have one address
LONGEST_WAIT_S = 900
FORGOTTEN_NS = 86_400 * 10**9


def count_try(session: Session, **told: str) -> float:
    """Count a try at `name=` from `address=`; 0.0 where it may go on, else the seconds to wait, and nothing counts."""
    now, kind_of = now_ns(), _kinds(told)
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


def take_back(session: Session, **told: str) -> None:
    """The password was right: all is forgotten of the name, and this one try of the address."""
    forgive_name(session, told["name"])
    row = session.get(FailedSignInRow, _key("address", told["address"]), with_for_update=True)
    if row is not None:
        row.failures, row.blocked_until_ns = max(0, row.failures - 1), 0


def forgive_name(session: Session, name: str) -> None:
    """Whoever has a new password may use it at once."""
    session.execute(delete(FailedSignInRow).where(FailedSignInRow.key == _key("name", name)))


def pause_s(kind: str, failures: int) -> int:
    """The wait before the next try after so many wrong ones: 0, then 1, 2, 4, … up to `LONGEST_WAIT_S`."""
    beyond = failures - FREE[kind]
    return 0 if beyond < 0 else min(LONGEST_WAIT_S, 2 ** min(beyond, 30))


def _kinds(told: Mapping[str, str]) -> dict[str, str]:
    return {_key(kind, value): kind for kind, value in told.items()}


def _key(kind: str, value: str) -> str:
    return sha256(f"{kind} {value}".encode()).hexdigest()
