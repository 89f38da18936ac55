"""How a worker's process speaks to its lease keeper: what its attempt says, and that it is there.

**Conventions.** Where no keeper answers, the process writes to the database itself.
"""

import socket
from contextlib import suppress
from typing import Any

import structlog

from services.runtime.database.transactions import Database
from services.runtime.jobs.attempt_words import AttemptWords
from services.runtime.jobs.lease_keeper import keeper_address
from services.runtime.jobs.lease_messages import MessageStream, answer_of, message_of, presence_message
from services.runtime.jobs.leases import LeaseAnswer, renew
from services.runtime.jobs.presence_rows import ProcessPresence
from services.runtime.telemetry.counters import Counts
from stone.errors import PlatformFaultError

log = structlog.get_logger(__name__)


class LeaseNotRenewedError(PlatformFaultError):
    """The keeper could not write; it is asked again in the next turn."""

    code = "lease_not_renewed"

    def __init__(self, reason: str) -> None:
        super().__init__(f"the lease keeper wrote nothing: {reason}")


class LeaseLine:
    """`renew(words)` and `close()` by one thread; another may `interrupt()` it."""

    def __init__(self, database: Database, patience_s: float) -> None:
        self._database, self._patience_s = database, patience_s
        self._address = keeper_address()
        self._stream: MessageStream | None = None
        self._is_interrupted = False

    def renew(self, words: AttemptWords) -> LeaseAnswer:
        """Raises `LeaseNotRenewedError`, what the database raises, `EOFError` once it is interrupted."""
        if self._address is not None:
            try:
                return self._asked(words)
            except (OSError, EOFError, ValueError, TypeError) as error:
                self.close()
                if self._is_interrupted:
                    raise EOFError from error
                log.warning("the lease keeper does not answer", reason=f"{type(error).__name__}: {error}"[:500])
                self._address = None  # for this attempt
        (answer,) = renew(self._database, [words])
        return answer

    def interrupt(self) -> None:
        """Whoever waits for an answer waits no more."""
        self._is_interrupted = True
        if (stream := self._stream) is not None:
            with suppress(OSError):
                stream.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.socket.close()

    def _asked(self, words: AttemptWords) -> LeaseAnswer:
        if self._stream is None:
            self._stream = opened(self._address or "", self._patience_s)
        if self._is_interrupted:
            raise EOFError
        self._stream.send(message_of(words))
        answer = self._stream.first()
        if "error" in answer:
            raise LeaseNotRenewedError(answer["error"])
        return answer_of(answer)


class PresenceLine:
    """`tell(present, counts)`: whether the keeper has it and will write it. Used by one thread."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._stream: MessageStream | None = None

    def tell(self, present: ProcessPresence, counts: Counts) -> bool:
        return self._is_heard(presence_message(present, counts))

    def leave(self, name: str) -> None:
        """The keeper writes the row of this process no more."""
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
    """A stream to who listens there. Raises `OSError`."""
    connecting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connecting.settimeout(patience_s)
    try:
        connecting.connect(address)
    except OSError:
        connecting.close()
        raise
    return MessageStream(connecting)
