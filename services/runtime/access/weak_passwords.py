"""Rejects guessable passwords: common ones, the user's own name, repetitions.

**Conventions.** `common_passwords.txt` stands for some 8,000 of the commonest leaked passwords, lower case and without
digits (of the list of the package zxcvbn 4.5, MIT licence, made from leaks of ten million), as the first four bytes of
each one's sha256: what many of them say nobody needs to read. What remains of a password without digits, signs and
spaces may not be one of them or one repeated. Looked up here, asking nobody: no password and no part of its hash
leaves the machine. Composition is not asked for (NIST SP 800-63B, 5.1.1.2; OWASP ASVS 2.1.7 and 2.1.9).
"""

import re
from functools import cache
from hashlib import sha256
from importlib.resources import files

from services.runtime.access.errors import GuessablePasswordError

FEWEST_CHARACTERS = 5
SHORTEST_NAME = 3
RUNS = ("abcdefghijklmnopqrstuvwxyz", "qwertyuiopasdfghjklzxcvbnm", "qwertzuiopasdfghjklyxcvbnm", "1234567890")
PLATFORM = ("traversability", "platform", "stone", "admin")
BESIDE = 4
"""So many letters beside a common password or a name are an ornament, not another word."""


def refuse_guessable(password: str, name: str = "") -> None:
    """Raises `GuessablePasswordError`; `name` is that of the user who is to have it."""
    folded = password.casefold()
    letters = "".join(character for character in folded if character.isalpha())
    if len(set(folded)) < FEWEST_CHARACTERS:
        raise GuessablePasswordError(f"has only {len(set(folded))} different characters")
    if _is_run(folded) or _is_run(folded[::-1]):
        raise GuessablePasswordError("is a run over the keyboard or the alphabet")
    if _is_about(letters, name):
        raise GuessablePasswordError("is the name of its user or of this platform with little beside it")
    if {_mark(folded), _mark(_once(letters))} & common_marks():
        raise GuessablePasswordError("is one of the commonest in the world, or one of them repeated or with numbers")


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
