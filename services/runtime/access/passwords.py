"""Password hashing (argon2id), in equal time for names that do not exist.

**Conventions.** Parameters are argon2-cffi's defaults, RFC 9106's second choice (64 MiB, 3 passes). At most `AT_ONCE`
passwords are hashed at a time and `MOST_WAITING` wait or are hashed, so that a flood of sign-ins costs bounded memory
and leaves threads for everybody else.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from secrets import token_urlsafe
from threading import BoundedSemaphore

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from services.runtime.access.errors import BusyError, WeakPasswordError
from services.runtime.access.weak_passwords import refuse_guessable

SHORTEST = 12
LONGEST = 1024  # argon2 hashes any length; nobody remembers more
AT_ONCE = 2
MOST_WAITING = 10

_hasher = PasswordHasher()
_turns = BoundedSemaphore(AT_ONCE)
_places = BoundedSemaphore(MOST_WAITING)


def hash_password(password: str, name: str = "") -> str:
    """The argon2id hash to keep for the user of this name.

    Raises `WeakPasswordError` below 12 or above 1024 characters, `GuessablePasswordError`, `BusyError`.
    """
    if not SHORTEST <= len(password) <= LONGEST:
        raise WeakPasswordError(len(password), SHORTEST, LONGEST)
    refuse_guessable(password, name)
    with _turn():
        return _hasher.hash(password)


def verify_password(password_hash: str, password: str) -> bool:
    """Whether it is the password. An empty hash (no such user, or no password) costs the same time and is false.

    Raises `BusyError`.
    """
    if len(password) > LONGEST:
        return False
    with _turn():
        try:
            _hasher.verify(password_hash or _nobodys(), password)
        except (VerificationError, InvalidHashError):
            return False
    return bool(password_hash)


@contextmanager
def _turn() -> Iterator[None]:
    if not _places.acquire(blocking=False):
        raise BusyError(MOST_WAITING)
    try:
        with _turns:
            yield
    finally:
        _places.release()


@cache
def _nobodys() -> str:
    return _hasher.hash(token_urlsafe(32))
