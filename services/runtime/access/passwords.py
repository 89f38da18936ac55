"""Password hashing (argon2id), in equal time for names that do not exist.

**Conventions.** Parameters are argon2-cffi's defaults, RFC 9106's second choice (64 MiB, 3 passes). At most `AT_ONCE`
passwords are hashed at a time and `MOST_WAITING` wait or are hashed, so that a flood of sign-ins costs bounded memory
and leaves threads for everybody else.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from hashlib import sha256
from importlib.resources import files
from secrets import token_urlsafe
from threading import BoundedSemaphore

from argon2 import PasswordHasher
from argon2.exceptions import InvalidHashError, VerificationError

from stone.errors import Refused

SHORTEST = 12
LONGEST = 1024  # argon2 hashes any length; nobody remembers more
AT_ONCE = 2
MOST_WAITING = 10

_hasher = PasswordHasher()
_turns = BoundedSemaphore(AT_ONCE)
_places = BoundedSemaphore(MOST_WAITING)


def hash_password(password: str, name: str = "") -> str:
    """The argon2id hash to keep for the user of this name.

    Raises `weak_password` below 12 or above 1024 characters, `guessable_password`, `busy`.
    """
    if not SHORTEST <= len(password) <= LONGEST:
        raise Refused(
            "weak_password", f"the password has {len(password)} characters; it must have {SHORTEST} to {LONGEST}"
        )
    refuse_guessable(password, name)
    with _turn():
        return _hasher.hash(password)


def verify_password(password_hash: str, password: str) -> bool:
    """Whether it is the password. An empty hash (no such user, or no password) costs the same time and is false.

    Raises `busy`.
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
        raise Refused("busy", f"{MOST_WAITING} passwords are being checked; try again in a moment")
    try:
        with _turns:
            yield
    finally:
        _places.release()


@cache
def _nobodys() -> str:
    return _hasher.hash(token_urlsafe(32))


# Rejects guessable passwords: common ones, the user's own name, repetitions.
#
# **Conventions.** `common_passwords.txt` stands for some 8,000 of the commonest leaked passwords, lower case and
# without digits (of the list of the package zxcvbn 4.5, MIT licence, made from leaks of ten million), as the first
# four bytes of each one's sha256: what many of them say nobody needs to read. What remains of a password without
# digits, signs and spaces may not be one of them or one repeated. Looked up here, asking nobody: no password and no
# part of its hash leaves the machine. Composition is not asked for (NIST SP 800-63B, 5.1.1.2; OWASP ASVS 2.1.7 and
# 2.1.9).


FEWEST_CHARACTERS = 5
SHORTEST_NAME = 3
RUNS = ("abcdefghijklmnopqrstuvwxyz", "qwertyuiopasdfghjklzxcvbnm", "qwertzuiopasdfghjklyxcvbnm", "1234567890")
PLATFORM = ("traversability", "platform", "stone", "admin")
BESIDE = 4
"""So many letters beside a common password or a name are an ornament, not another word."""


def refuse_guessable(password: str, name: str = "") -> None:
    """Raises `guessable_password`; `name` is that of the user who is to have it."""
    folded = password.casefold()
    letters = "".join(character for character in folded if character.isalpha())
    if len(set(folded)) < FEWEST_CHARACTERS:
        raise guessable_password(f"has only {len(set(folded))} different characters")
    if _is_run(folded) or _is_run(folded[::-1]):
        raise guessable_password("is a sequence on the keyboard or in the alphabet")
    if _is_about(letters, name):
        raise guessable_password("is little more than the user name or the platform's name")
    if {_mark(folded), _mark(_once(letters))} & common_marks():
        raise guessable_password("is a very common password, possibly repeated or with numbers added")


@cache
def common_marks() -> frozenset[str]:
    """What `_mark` makes of the common ones."""
    return frozenset(files("services.runtime.access").joinpath("common_passwords.txt").read_text("utf-8").split())


def _mark(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:8]


def _is_run(folded: str) -> bool:
    """Whether it goes along one of the runs, round and round."""
    plain = re.sub(r"[\W_]+", "", folded)
    return any(plain in run * (len(plain) // len(run) + 2) for run in RUNS)


def _is_about(letters: str, name: str) -> bool:
    plain = "".join(character for character in name.casefold() if character.isalpha())
    left = letters
    for word in (plain, *PLATFORM):
        left = left.replace(word, "") if len(word) >= SHORTEST_NAME else left
    return left != letters and len(left) <= BESIDE


def _once(letters: str) -> str:
    """The shortest text that it is a repetition of."""
    return letters[: (letters + letters).find(letters, 1)] if letters else ""


def guessable_password(reason: str) -> Refused:
    return Refused("guessable_password", f"the password {reason}; choose several unrelated words")
