"""Readiness probes: whether database, broker and store respond, and in how many milliseconds.

**Conventions.** Each part has its own thread and one probe at a time, so a part that hangs costs one thread and is
reported away. Results are cached for `FRESH_S`, so frequent probes cost no more. The store probe writes, reads and
deletes a small object, because a full, read-only or unmounted disk can still list files.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures import TimeoutError as TooSlowError
from pathlib import Path
from secrets import token_bytes, token_hex
from tempfile import NamedTemporaryFile
from typing import Literal

import structlog
from redis import Redis
from sqlalchemy import text

from api.schemas.people import PartState
from services.runtime.platform import Platform

PATIENCE_S = 3.0
FRESH_S = 1.0
PART_NAMES = ("database", "broker", "store")

log = structlog.get_logger(__name__)


class Probes:
    """Probes of the three parts; `ask()` returns their states."""

    def __init__(self, platform: Platform) -> None:
        self._platform = platform
        self._broker = Redis.from_url(platform.settings.broker.address, socket_connect_timeout=2, socket_timeout=2)
        self._asked: dict[str, tuple[Future[float], float]] = {}
        self._key = f"probes/{token_hex(8)}"
        self._threads = ThreadPoolExecutor(len(PART_NAMES), thread_name_prefix="probe")

    def ask(self) -> dict[str, PartState]:
        """Return the health of each part, within `PATIENCE_S`."""
        questions = zip(PART_NAMES, (self._database, self._ping, self._store), strict=True)
        futures = {name: self._ask(name, question) for name, question in questions}
        deadline_s = time.monotonic() + PATIENCE_S
        return {name: _state(name, future, deadline_s) for name, future in futures.items()}

    def _ask(self, name: str, question: Callable[[], object]) -> Future[float]:
        known, since_s = self._asked.get(name, (None, 0.0))
        if known is None or (known.done() and time.monotonic() - since_s >= FRESH_S):
            known = self._threads.submit(_timed, question)
            self._asked[name] = known, time.monotonic()
        return known

    def _database(self) -> None:
        with self._platform.database.reading() as session:
            session.execute(text("SELECT 1"))

    def _ping(self) -> None:
        self._broker.ping()

    def _store(self) -> None:
        store, sent = self._platform.store, token_bytes(16)
        with NamedTemporaryFile(prefix="stone-probe-") as file:
            file.write(sent)
            file.flush()
            store.write(self._key, Path(file.name))
        kept = b"".join(store.read(self._key))
        store.delete(self._key)
        if kept != sent:
            raise OSError("the store returned bytes that differ from the written ones")


def _timed(question: Callable[[], object]) -> float:
    begun = time.perf_counter()
    question()
    return (time.perf_counter() - begun) * 1e3


def _state(name: str, asked: Future[float], deadline_s: float) -> PartState:
    state: Literal["up", "away"] = "up"
    took_ms = PATIENCE_S * 1e3
    try:
        took_ms = asked.result(max(deadline_s - time.monotonic(), 0.0))
    except TooSlowError:
        state = "away"
    except Exception as error:  # any driver error means that the part is away; the reason is only logged
        log.warning("part unavailable", part=name, reason=str(error)[:300])
        state, took_ms = "away", 0.0
    return PartState(state=state, took_ms=round(took_ms, 2))
