"""The lease keeper of a worker: a process that renews the leases of all its attempts together.

Without it each process of a worker sends heartbeats for its own job. With it the processes send their reports to the
keeper, which writes all reports of `progress_s` in one transaction, and answers each.

**Conventions.** The keeper sends a heartbeat for an attempt only after a report of its own process: a hanging or killed
process loses its lease as without a keeper. If no keeper answers, a process writes to the database itself. The keeper
is forked before the pool, ignores the worker's signals, and ends with the worker's parent. Its address is an abstract
socket (unix(7)), which needs no file; connections of other users are refused.
"""

import json
import os
import selectors
import signal
import socket
import struct
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from secrets import token_hex
from typing import Any

import structlog
from sqlalchemy import case
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from services.runtime.database.clock import database_ns
from services.runtime.database.transactions import Database
from services.runtime.jobs.attempt_lines import AttemptLine, AttemptWords, JobProgress
from services.runtime.jobs.leases import LeaseAnswer, renew
from services.runtime.orm import Worker
from services.runtime.processes.parent_death import die_with
from services.runtime.settings import Settings
from services.runtime.telemetry.counter_rows import CounterWriter
from services.runtime.telemetry.counters import Counts, ProcessCounters
from services.runtime.telemetry.log_lines import speak_json
from stone.errors import PlatformFaultError

# Rows of worker processes, of any number of processes in one statement.


@dataclass(frozen=True)
class ProcessPresence:
    """A process and its resources and those of its machine, as in the row of that name."""

    name: str
    queues: str
    started_ns: int
    held_bytes: int | None
    memory_free_bytes: int | None
    memory_bytes: int | None
    disk_free_bytes: int | None
    disk_bytes: int | None


def write_presence(session: Session, present: Sequence[ProcessPresence]) -> None:
    """Insert or update their rows; the row of another process with a reused pid starts again."""
    ordered = sorted(present, key=lambda process: process.name)  # a common order prevents deadlocks
    rows = [{**asdict(process), "beat_ns": database_ns(), "beats": 1} for process in ordered]
    dialect = sqlite if session.get_bind().dialect.name == "sqlite" else postgresql
    inserted = dialect.insert(Worker).values(rows)
    updated = {name: inserted.excluded[name] for name in rows[0] if name not in ("name", "beats")}
    beats = case((Worker.started_ns == inserted.excluded.started_ns, Worker.beats + 1), else_=1)
    session.execute(inserted.on_conflict_do_update(index_elements=[Worker.name], set_={**updated, "beats": beats}))


# Messages between the processes of a worker and its lease keeper: JSON, preceded by its length. The two ends belong to
# one worker and one user. JSON preserves values that a database may reject (lone surrogates, NaN), so that the
# rejection is reported.


LENGTH = struct.Struct(">I")
LONGEST_BYTES = 64 * 2**20


class MessageStream:
    """Whole messages of a socket; partial messages of each end are kept between calls."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        self._held = bytearray()

    def send(self, message: Any) -> None:
        """Send a message. Raises `OSError`; `TypeError` and `ValueError` for values that JSON cannot represent."""
        content = json.dumps(message).encode("ascii")
        self.socket.sendall(LENGTH.pack(len(content)) + content)

    def receive(self) -> list[Any]:
        """Return the messages after one read; empty if none is complete yet.

        Raises `EOFError` at the end, `OSError`, `ValueError` for an invalid message.
        """
        if not (more := self.socket.recv(2**16)):
            raise EOFError
        self._held += more
        messages = []
        while (whole := self._taken()) is not None:
            messages.append(json.loads(whole))
        return messages

    def first(self) -> Any:
        """Wait for the next message and return it. Raises as `receive`."""
        while not (messages := self.receive()):
            pass
        return messages[0]

    def _taken(self) -> bytes | None:
        if len(self._held) < LENGTH.size:
            return None
        (length,) = LENGTH.unpack_from(self._held)
        if length > LONGEST_BYTES:
            raise ValueError(f"a message of {length} bytes; at most {LONGEST_BYTES} are accepted")
        end = LENGTH.size + length
        if len(self._held) < end:
            return None
        whole = bytes(self._held[LENGTH.size : end])
        del self._held[:end]
        return whole


def message_of(words: AttemptWords) -> dict[str, Any]:
    return asdict(words)


def words_of(message: dict[str, Any]) -> AttemptWords:
    """Return the report. Raises `TypeError` and `KeyError` for messages not from `message_of`."""
    progress = message["progress"]
    lines = tuple(AttemptLine(**line) for line in message["lines"])
    reported = None if progress is None else JobProgress(**progress)
    return AttemptWords(message["job_id"], message["attempt"], reported, lines)


def presence_message(present: ProcessPresence, counts: Counts) -> dict[str, Any]:
    return {"present": asdict(present), "counts": counts}


def answer_of(message: dict[str, Any]) -> LeaseAnswer:
    return LeaseAnswer(**message)


_CREDENTIALS = struct.Struct("3i")

log = structlog.get_logger(__name__)


@dataclass
class LeaseKeeper:
    """`serve()` runs forever; a turn is taken at most once every `turn_s`.

    The presence of a process is written with the next turn of attempts, or after `presence_s`.
    """

    database: Database
    listener: socket.socket
    turn_s: float
    presence_s: float
    _selector: selectors.DefaultSelector = field(default_factory=selectors.DefaultSelector)
    _reports: list[tuple[MessageStream, AttemptWords]] = field(default_factory=list)
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
        """Close all connections."""
        for key in list(self._selector.get_map().values()):
            if key.fileobj is not self.listener:
                self._drop(key.data)
        self._selector.close()

    def step(self, patience_s: float | None = None) -> None:
        """Receive messages until the next turn is due, or for `patience_s`; or take the turn."""
        due_s = self._due_s()
        if due_s is not None and due_s <= 0:
            self._take_turn()
            return
        patient = [wait_s for wait_s in (due_s, patience_s) if wait_s is not None]
        for key, _ in self._selector.select(min(patient, default=None)):
            if key.fileobj is self.listener:
                self._accept()
            else:
                self._hear(key.data)

    def _due_s(self) -> float | None:
        """Return the seconds until the next turn; None if nothing was received."""
        now_s = time.monotonic()
        dues = [self._turned_s + self.turn_s] if self._reports else []
        if self._present:
            dues.append(max(self._turned_s + self.turn_s, self._present_s + self.presence_s))
        return min(dues) - now_s if dues else None

    def _accept(self) -> None:
        connected, _ = self.listener.accept()
        _, user, _ = _CREDENTIALS.unpack(connected.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size))
        if user != os.geteuid():
            connected.close()
            return
        connected.settimeout(self.turn_s)  # a process that does not read its answer must not delay others
        self._selector.register(connected, selectors.EVENT_READ, MessageStream(connected))

    def _hear(self, stream: MessageStream) -> None:
        try:
            for message in stream.receive():
                self._take(stream, message)
        except (EOFError, OSError, ValueError, TypeError, KeyError):
            self._drop(stream)

    def _take(self, stream: MessageStream, message: dict[str, Any]) -> None:
        if "job_id" in message:
            self._reports.append((stream, words_of(message)))
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
        reports, self._reports, self._turned_s = self._reports, [], time.monotonic()
        last = {(stream, words.key): words for stream, words in reports}
        present, committed = list(self._present.values()), list[Callable[[], None]]()

        def beside(session: Session) -> None:
            if present:
                write_presence(session, present)
                committed.append(self._counter_row.tell(session))

        try:
            answers = renew(self.database, list(last.values()), beside)
            self._confirm_written(present, committed)
        except Exception as error:
            log.warning("heartbeats not written; the jobs continue", jobs=len(last), reason=str(error)[:500])
            self._present_s = self._turned_s
            for stream, _ in last:
                self._answer(stream, {"error": f"{type(error).__name__}: {error}"[:500]})
            return
        for (stream, _), answer in zip(last, answers, strict=True):
            self._answer(stream, asdict(answer))

    def _confirm_written(self, present: Sequence[ProcessPresence], committed: Sequence[Callable[[], None]]) -> None:
        """Confirm written rows; processes whose reports were rejected are written in the next turn."""
        for noted in committed:
            noted()
        if committed:
            self._present = {name: process for name, process in self._present.items() if process not in present}

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
    """Return the address of this worker's keeper; None if there is none."""
    return _ADDRESS[0] if _ADDRESS else None


def start_keeper(settings: Settings) -> int:
    """Fork the keeper of this worker, to which its processes connect from then on; return its pid."""
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
    """Run the forked process."""
    try:
        die_with(parent)
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)
        os.closerange(3, listener.fileno())  # the worker's own: to its fork server, to its broker
        os.closerange(listener.fileno() + 1, os.sysconf("SC_OPEN_MAX"))
        speak_json()
        LeaseKeeper(Database(settings), listener, settings.jobs.progress_s, settings.jobs.heartbeat_s / 2).serve()
    except BaseException:
        log.exception("the lease keeper ends; each process sends its own heartbeats")
    finally:
        os._exit(1)


# The connection of a worker's process to its lease keeper, for reports of its attempt and for its presence. If no
# keeper answers, the process writes to the database itself.


class LeaseLine:
    """`renew(words)` and `close()` are for one thread; another may `interrupt()` it."""

    def __init__(self, database: Database, patience_s: float) -> None:
        self._database, self._patience_s = database, patience_s
        self._address = keeper_address()
        self._stream: MessageStream | None = None
        self._is_interrupted = False

    def renew(self, words: AttemptWords) -> LeaseAnswer:
        """Send a report and return the answer.

        Raises `lease_not_renewed`, what the database raises, `EOFError` after an interruption.
        """
        if self._address is not None:
            try:
                return self._request(words)
            except (OSError, EOFError, ValueError, TypeError) as error:
                self.close()
                if self._is_interrupted:
                    raise EOFError from error
                log.warning("the lease keeper does not answer", reason=f"{type(error).__name__}: {error}"[:500])
                self._address = None  # for this attempt
        (answer,) = renew(self._database, [words])
        return answer

    def interrupt(self) -> None:
        """Stop a thread that waits for an answer."""
        self._is_interrupted = True
        if (stream := self._stream) is not None:
            with suppress(OSError):
                stream.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.socket.close()

    def _request(self, words: AttemptWords) -> LeaseAnswer:
        if self._stream is None:
            self._stream = opened(self._address or "", self._patience_s)
        if self._is_interrupted:
            raise EOFError
        self._stream.send(message_of(words))
        answer = self._stream.first()
        if "error" in answer:
            raise PlatformFaultError("lease_not_renewed", f"the lease keeper wrote nothing: {answer['error']}")
        return answer_of(answer)


class PresenceLine:
    """`tell(present, counts)` returns whether the keeper will write the presence. For one thread."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._stream: MessageStream | None = None

    def tell(self, present: ProcessPresence, counts: Counts) -> bool:
        return self._is_heard(presence_message(present, counts))

    def leave(self, name: str) -> None:
        """Make the keeper stop writing this process's row."""
        self._is_heard({"gone": name})
        self.close()

    def _is_heard(self, message: Any) -> bool:
        if (address := keeper_address()) is None:
            return False
        try:
            if self._stream is None:
                self._stream = opened(address, self._patience_s)
            self._stream.send(message)
            self._stream.first()
        except (OSError, EOFError, ValueError) as error:
            log.warning("the lease keeper does not answer", reason=f"{type(error).__name__}: {error}"[:500])
            self.close()
            return False
        return True

    def close(self) -> None:
        if self._stream is not None:
            self._stream.socket.close()
        self._stream = None


def opened(address: str, patience_s: float) -> MessageStream:
    """Return a stream to the listener at the address. Raises `OSError`."""
    connecting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connecting.settimeout(patience_s)
    try:
        connecting.connect(address)
    except OSError:
        connecting.close()
        raise
    return MessageStream(connecting)
