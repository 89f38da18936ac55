"""How a running attempt renews its lease: by the worker's keeper, or itself where no keeper answers."""

import socket
from contextlib import suppress

import structlog

from services.runtime.database.transactions import Database
from services.runtime.jobs.attempt_words import AttemptWords
from services.runtime.jobs.lease_keeper import keeper_address
from services.runtime.jobs.lease_messages import MessageStream, answer_of, message_of
from services.runtime.jobs.leases import LeaseAnswer, renew
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
        stream = self._connected()
        stream.send(message_of(words))
        while not (answers := stream.receive()):
            pass
        if "error" in answers[0]:
            raise LeaseNotRenewedError(answers[0]["error"])
        return answer_of(answers[0])

    def _connected(self) -> MessageStream:
        if self._stream is None:
            connecting = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
            connecting.settimeout(self._patience_s)
            self._stream = MessageStream(connecting)
            connecting.connect(self._address or "")
        if self._is_interrupted:
            raise EOFError
        return self._stream
