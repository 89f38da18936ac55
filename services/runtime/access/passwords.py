"""Passwords: argon2id, and the same work for a name that does not exist.

**Conventions.** Parameters are argon2-cffi's defaults, RFC 9106's second choice (64 MiB, 3 passes). At most
`AT_ONCE` passwords are hashed at a time, so that a flood of sign-ins costs a bounded amount of memory.
"""

from functools import cache
from secrets import token_urlsafe
from threading import BoundedSemaphore

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from services.runtime.access.errors import WeakPasswordError

SHORTEST = 12
LONGEST = 1024  # argon2 hashes any length; nobody remembers more
AT_ONCE = 2

_hasher = PasswordHasher()
_turns = BoundedSemaphore(AT_ONCE)


def hash_password(password: str) -> str:
    """The argon2id hash to keep. Raises `WeakPasswordError` below 12 or above 1024 characters."""
    if not SHORTEST <= len(password) <= LONGEST:
        raise WeakPasswordError(len(password), SHORTEST, LONGEST)
    with _turns:
        return _hasher.hash(password)


def verify_password(password_hash: str, password: str) -> bool:
    """Whether it is the password. An empty hash (no such user, or no password) costs the same time and is false."""
    if len(password) > LONGEST:
        return False
    with _turns:
        try:
            _hasher.verify(password_hash or _nobodys(), password)
        except (VerificationError, InvalidHashError):
            return False
    return bool(password_hash)


@cache
def _nobodys() -> str:
    return _hasher.hash(token_urlsafe(32))
