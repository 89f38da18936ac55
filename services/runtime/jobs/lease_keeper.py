"""The lease keeper of a worker: a process that renews the leases of all its attempts together.

Without it each process of a worker beats for its own job. With it they say what they have to say to the keeper, which
writes what has come within `progress_s` in one transaction, and answers each.

**Conventions.** An attempt is beaten for when its own process has said so, and never otherwise: one that hangs or was
killed falls silent as it does without a keeper. Where no keeper answers, a process speaks to the database itself. The
keeper is forked before the pool, hears no signal that is meant for the worker, and ends with the worker's parent. Its
address is an abstract socket (unix(7)), which needs no file; who is not of its own user is not heard.
"""

import os
import selectors
import signal
import socket
import struct
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from secrets import token_hex
from typing import Any

import structlog
from sqlalchemy.orm import Session

from services.runtime.database.transactions import Database
from services.runtime.jobs.attempt_words import AttemptWords
from services.runtime.jobs.lease_messages import MessageStream, words_of
from services.runtime.jobs.leases import renew
from services.runtime.jobs.presence_rows import ProcessPresence, write_presence
from services.runtime.processes.parent_death import die_with
from services.runtime.settings import Settings
from services.runtime.telemetry.counter_rows import CounterWriter
from services.runtime.telemetry.counters import Counts, ProcessCounters
from services.runtime.telemetry.log_lines import speak_json

_CREDENTIALS = struct.Struct("3i")

log = structlog.get_logger(__name__)


@dataclass
class LeaseKeeper:
    """`serve()` for ever; a turn is taken at most once every `turn_s`.

    That a process is there waits for a turn of attempts, or for `presence_s`.
    """

    database: Database
    listener: socket.socket
    turn_s: float
    presence_s: float
    _selector: selectors.DefaultSelector = field(default_factory=selectors.DefaultSelector)
    _said: list[tuple[MessageStream, AttemptWords]] = field(default_factory=list)
    _present: dict[str, ProcessPresence] = field(default_factory=dict)
    _present_s: float = 0.0
    _turned_s: float = float("-inf")
    _counters: ProcessCounters = field(default_factory=ProcessCounters)

    def __post_init__(self) -> None:
        self._counter_row = CounterWriter(self._counters)

    def serve(self) -> None:
        self.begin()
        while True:
            self.step()

    def begin(self) -> None:
        self._selector.register(self.listener, selectors.EVENT_READ)

    def close(self) -> None:
        """Hear nobody any more."""
        for key in list(self._selector.get_map().values()):
            if key.fileobj is not self.listener:
                self._drop(key.data)
        self._selector.close()

    def step(self, patience_s: float | None = None) -> None:
        """Hear what comes until the next turn is due, or for `patience_s`; or take it."""
        due_s = self._due_s()
        if due_s is not None and due_s <= 0:
            self._take_turn()
            return
        patient = [one for one in (due_s, patience_s) if one is not None]
        for key, _ in self._selector.select(min(patient, default=None)):
            if key.fileobj is self.listener:
                self._accept()
            else:
                self._hear(key.data)

    def _due_s(self) -> float | None:
        """In how many seconds a turn is due; None where nothing was said."""
        now_s = time.monotonic()
        dues = [self._turned_s + self.turn_s] if self._said else []
        if self._present:
            dues.append(max(self._turned_s + self.turn_s, self._present_s + self.presence_s))
        return min(dues) - now_s if dues else None

    def _accept(self) -> None:
        connected, _ = self.listener.accept()
        _, user, _ = _CREDENTIALS.unpack(connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
        if user != os.geteuid():
            connected.close()
            return
        connected.settimeout(self.turn_s)  # who does not take its answer holds nobody else up
        self._selector.register(connected, selectors.EVENT_READ, MessageStream(connected))

    def _hear(self, stream: MessageStream) -> None:
        try:
            for message in stream.receive():
                self._take(stream, message)
        except (EOFError, OSError, ValueError, TypeError, KeyError):
            self._drop(stream)

    def _take(self, stream: MessageStream, message: dict[str, Any]) -> None:
        if "job_id" in message:
            self._said.append((stream, words_of(message)))
            return
        if "present" in message:
            self._note(ProcessPresence(**message["present"]), message["counts"])
        else:
            self._present.pop(message["gone"], None)
        stream.send({})

    def _note(self, present: ProcessPresence, counts: Counts) -> None:
        if not self._present:
            self._present_s = time.monotonic()
        self._present[present.name] = present
        self._counters.merge(counts)

    def _take_turn(self) -> None:
        said, self._said, self._turned_s = self._said, [], time.monotonic()
        last = {(stream, words.key): words for stream, words in said}
        present, committed = list(self._present.values()), list[Callable[[], None]]()

        def beside(session: Session) -> None:
            if present:
                write_presence(session, present)
                committed.append(self._counter_row.tell(session))

        try:
            answers = renew(self.database, list(last.values()), beside)
            self._told(present, committed)
        except Exception as error:
            log.warning("heartbeats not written; the jobs go on", jobs=len(last), reason=str(error)[:500])
            self._present_s = self._turned_s
            for stream, _ in last:
                self._answer(stream, {"error": f"{type(error).__name__}: {error}"[:500]})
            return
        for (stream, _), answer in zip(last, answers, strict=True):
            self._answer(stream, asdict(answer))

    def _told(self, present: Sequence[ProcessPresence], committed: Sequence[Callable[[], None]]) -> None:
        """Their rows are written; where words were refused they are told in the next turn."""
        for noted in committed:
            noted()
        if committed:
            self._present = {name: one for name, one in self._present.items() if one not in present}

    def _answer(self, stream: MessageStream, message: dict[str, object]) -> None:
        try:
            stream.send(message)
        except OSError:
            self._drop(stream)

    def _drop(self, stream: MessageStream) -> None:
        if stream.socket.fileno() >= 0:
            self._selector.unregister(stream.socket)
            stream.socket.close()


_ADDRESS: list[str] = []


def keeper_address() -> str | None:
    """Where the keeper of this worker listens; None where there is none."""
    return _ADDRESS[0] if _ADDRESS else None


def start_keeper(settings: Settings) -> int:
    """Fork the keeper of this worker, whose processes find it from then on; its pid."""
    address = f"\0stone-leases-{os.getpid()}-{token_hex(16)}"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    listener.bind(address)
    listener.listen(1024)
    parent = os.getpid()
    if (pid := os.fork()) == 0:
        _keep(settings, listener, parent)
    listener.close()
    _ADDRESS[:] = [address]
    return pid


def _keep(settings: Settings, listener: socket.socket, parent: int) -> None:
    """All that the forked process does."""
    try:
        die_with(parent)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        os.closerange(3, listener.fileno())  # the worker's own: to its fork server, to its broker
        os.closerange(listener.fileno() + 1, os.sysconf("SC_OPEN_MAX"))
        speak_json()
        LeaseKeeper(Database(settings), listener, settings.jobs.progress_s, settings.jobs.heartbeat_s / 2).serve()
    except BaseException:
        log.exception("the lease keeper ends; each process beats for itself")
    finally:
        os._exit(1)
