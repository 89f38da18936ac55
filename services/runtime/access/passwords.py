"""Password hashing (argon2id), in equal time for unknown names.

**Conventions.** Parameters are argon2-cffi's defaults, RFC 9106's second choice (64 MiB, 3 passes). At most `AT_ONCE`
passwords are hashed at a time, and at most `MOST_WAITING` are hashed or wait. A flood of sign-ins therefore needs
bounded memory and leaves threads for other requests.
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
LONGEST = 1024  # argon2 hashes any length; longer passwords are impractical
AT_ONCE = 2
MOST_WAITING = 10

_hasher = PasswordHasher()
_turns = BoundedSemaphore(AT_ONCE)
_places = BoundedSemaphore(MOST_WAITING)


def hash_password(password: str, name: str = "") -> str:
    """Return the argon2id hash to store for the user with this name.

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
    """Return whether the password is right. An empty hash (unknown user, or no password) takes the same time.

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


# Rejects guessable passwords: common ones, the user's own name, repetitions. `common_passwords.txt` represents about
# 8,000 of the most common leaked passwords, lower case and without digits. They come from the list of the package
# zxcvbn 4.5 (MIT licence), made from leaks of ten million. The file contains the first four bytes of their sha256,
# because many of them are offensive. The rest of a password without digits, signs and spaces must not be one of them or
# a repetition. The check is local: no password and no part of its hash leaves the machine. Composition rules are not
# required (NIST SP 800-63B, 5.1.1.2; OWASP ASVS 2.1.7 and 2.1.9).


FEWEST_CHARACTERS = 5
SHORTEST_NAME = 3
RUNS = ("abcdefghijklmnopqrstuvwxyz", "qwertyuiopasdfghjklzxcvbnm", "qwertzuiopasdfghjklyxcvbnm", "1234567890")
PLATFORM = ("traversability", "platform", "stone", "admin")
BESIDE = 4
"""Up to this many letters beside a common password or a name are an ornament, not another word."""


def refuse_guessable(password: str, name: str = "") -> None:
    """Raise `guessable_password`; `name` is the name of the password's user."""
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
    """Return the marks (`_mark`) of the common passwords."""
    return frozenset(files("services.runtime.access").joinpath("common_passwords.txt").read_text("utf-8").split())


def _mark(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:8]


def _is_run(folded: str) -> bool:
    """Return whether the text follows one of the sequences, cyclically."""
    plain = re.sub(r"[\W_]+", "", folded)
    return any(plain in run * (len(plain) // len(run) + 2) for run in RUNS)


def _is_about(letters: str, name: str) -> bool:
    plain = "".join(character for character in name.casefold() if character.isalpha())
    left = letters
    for word in (plain, *PLATFORM):
        left = left.replace(word, "") if len(word) >= SHORTEST_NAME else left
    return left != letters and len(left) <= BESIDE


def _once(letters: str) -> str:
    """Return the shortest text whose repetition is this text."""
    return letters[: (letters + letters).find(letters, 1)] if letters else ""


def guessable_password(reason: str) -> Refused:
    return Refused("guessable_password", f"the password {reason}; choose several unrelated words")
