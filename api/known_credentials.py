"""Callers remembered by their credential, so that not every request reads the database for who is asking.

**Conventions.** For `KEPT_S`, under the sha256 of the secret, never the secret. A change of a user, a token or a
session by this process is noticed with its commit, one by another process after `KEPT_S` at the latest. What ends by
the clock is not remembered beyond its end. What is not valid is not remembered: it is looked up each time.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from threading import Lock
from typing import Generic, TypeVar

from cachetools import LRUCache

from services.runtime.access.credential_changes import credentials_generation
from services.runtime.orm.base import now_ns

KEPT_S = 1.0
MOST = 10_000

C = TypeVar("C")


@dataclass(frozen=True)
class _KnownCaller(Generic[C]):
    caller: C
    generation: int
    expires_ns: int
    until_s: float


class KnownCredentials(Generic[C]):
    """`find(secret)`, and `learn(secret, …)` where that gave None."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._now_s, self._lock = monotonic_s, Lock()
        self._known: LRUCache[bytes, _KnownCaller[C]] = LRUCache(MOST)

    def find(self, secret: str) -> C | None:
        """The caller with this credential; None where it must be looked up."""
        with self._lock:
            known = self._known.get(_key(secret))
        if known is None or known.generation != credentials_generation():
            return None
        return known.caller if known.until_s > self._now_s() and known.expires_ns > now_ns() else None

    def learn(self, secret: str, caller: C, *, expires_ns: int, generation: int) -> None:
        """Remember what was read of the database since `generation` was `credentials_generation()`."""
        known = _KnownCaller(caller, generation, expires_ns, self._now_s() + KEPT_S)
        with self._lock:
            self._known[_key(secret)] = known


def _key(secret: str) -> bytes:
    return sha256(secret.encode()).digest()
