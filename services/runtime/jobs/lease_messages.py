"""Messages between the processes of a worker and its lease keeper: JSON, its length before it.

**Conventions.** Both ends are processes of one worker and of one user. JSON keeps what a database may refuse (lone
surrogates, NaN), so that it is refused there and said so.
"""

import json
import socket
import struct
from dataclasses import asdict
from typing import Any

from services.runtime.jobs.attempt_words import AttemptLine, AttemptWords, JobProgress
from services.runtime.jobs.leases import LeaseAnswer
from services.runtime.jobs.presence_rows import ProcessPresence
from services.runtime.telemetry.counters import Counts

LENGTH = struct.Struct(">I")
LONGEST_BYTES = 64 * 2**20


class MessageStream:
    """Whole messages of a socket; each end's partial one is kept between two calls."""

    def __init__(self, connected: socket.socket) -> None:
        self.socket = connected
        self._held = bytearray()

    def send(self, message: Any) -> None:
        """Raises `OSError`; `TypeError` and `ValueError` for what is no JSON."""
        content = json.dumps(message).encode("ascii")
        self.socket.sendall(LENGTH.pack(len(content)) + content)

    def receive(self) -> list[Any]:
        """What has come, after one read; empty where no message is whole yet.

        Raises `EOFError` at the end, `OSError`, `ValueError` for what is no message.
        """
        if not (more := self.socket.recv(2**16)):
            raise EOFError
        self._held += more
        found = []
        while (whole := self._taken()) is not None:
            found.append(json.loads(whole))
        return found

    def first(self) -> Any:
        """The next message, waited for. Raises as `receive`."""
        while not (found := self.receive()):
            pass
        return found[0]

    def _taken(self) -> bytes | None:
        if len(self._held) < LENGTH.size:
            return None
        (length,) = LENGTH.unpack_from(self._held)
        if length > LONGEST_BYTES:
            raise ValueError(f"a message of {length} bytes; at most {LONGEST_BYTES} are taken")
        end = LENGTH.size + length
        if len(self._held) < end:
            return None
        whole = bytes(self._held[LENGTH.size : end])
        del self._held[:end]
        return whole


def message_of(words: AttemptWords) -> dict[str, Any]:
    return asdict(words)


def words_of(message: dict[str, Any]) -> AttemptWords:
    """Raises `TypeError` and `KeyError` for what `message_of` did not make."""
    progress = message["progress"]
    lines = tuple(AttemptLine(**line) for line in message["lines"])
    told = None if progress is None else JobProgress(**progress)
    return AttemptWords(message["job_id"], message["attempt"], told, lines)


def presence_message(present: ProcessPresence, counts: Counts) -> dict[str, Any]:
    return {"present": asdict(present), "counts": counts}


def answer_of(message: dict[str, Any]) -> LeaseAnswer:
    return LeaseAnswer(**message)
