"""Sentences that may break a rule, each with a reason: `exceptions.toml`."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from testing.english.rules import Hit

EXCEPTIONS = Path(__file__).with_name("exceptions.toml")


class Exempted(NamedTuple):
    """A sentence of a file that may break a rule: a part of it, and the reason."""

    path: str
    rule: str
    part: str
    reason: str

    def holds(self, hit: Hit) -> bool:
        """Return whether the hit is this sentence."""
        return hit.text.path.startswith(self.path) and hit.rule == self.rule and self.part in hit.sentence


def exceptions(path: Path = EXCEPTIONS) -> list[Exempted]:
    """Read all exceptions. Raises TypeError if an entry lacks a key, ValueError if a reason is empty."""
    entries = [Exempted(**entry) for entry in tomllib.loads(path.read_text("utf-8")).get("exception", [])]
    if any(not entry.reason.strip() for entry in entries):
        raise ValueError("an exception has no reason")
    return entries


def without_exceptions(hits: Sequence[Hit]) -> tuple[list[Hit], list[Exempted]]:
    """Return the hits that no exception holds for, and the exceptions that hold for no hit."""
    entries = exceptions()
    remaining = [hit for hit in hits if not any(entry.holds(hit) for entry in entries)]
    return remaining, [entry for entry in entries if not any(entry.holds(hit) for hit in hits)]
