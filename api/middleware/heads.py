"""An uvicorn protocol that bounds connections and request heads: `--http api.middleware.heads:BoundedHeads`.

**Conventions.** httptools buffers a head until it is complete, so one connection with an endless head would take all
memory, before any authentication. Beyond `MOST_HEAD_BYTES` plus one read the response is 431 and the connection ends
(RFC 6585 §5). uvicorn's other parser, h11, has the same bound.

A connection has `STONE_API__HEAD_S` to complete its first head, and the same time after each response for the next. The
timer of uvicorn itself closes an idle connection sooner after a response. The unread rest of an answered request's body
is discarded within the same time. If a client accepts no byte for `STALL_S`, the connection is aborted.
"""

import logging
from asyncio import BaseTransport, TimerHandle
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from api.middleware.connections import Connections

MOST_HEAD_BYTES = 64 * 1024
STALL_S = 60.0
END = b"connection: close\r\ncontent-length: 0\r\n\r\n"
TOO_LARGE = b"HTTP/1.1 431 Request Header Fields Too Large\r\n" + END
TOO_SLOW = b"HTTP/1.1 408 Request Timeout\r\n" + END
TOO_MANY = b"HTTP/1.1 503 Service Unavailable\r\nretry-after: 60\r\n" + END


class BoundedHeads(HttpToolsProtocol):
    """uvicorn's own protocol over httptools, with the bounds."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._connections = _connections_of(self.app)
        self._is_in_head, self._head_bytes = True, 0
        self._peer, self._is_admitted = "", False
        self._deadline: TimerHandle | None = None
        self._stall: TimerHandle | None = None

    def connection_made(self, transport: BaseTransport) -> None:
        super().connection_made(transport)  # type: ignore[arg-type]  # as uvicorn declares it
        self._peer = self.client[0] if self.client else ""
        self._is_admitted = self._connections.admit(self._peer, transport.get_extra_info("socket").fileno())
        if self._is_admitted:
            self._arm()
        else:
            self._close(TOO_MANY, is_refused=True)

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._disarm()
        self.resume_writing()
        if self._is_admitted:
            self._connections.leave(self._peer)

    def data_received(self, data: bytes) -> None:
        if self._is_in_head:
            self._head_bytes += len(data)
        super().data_received(data)
        if self._is_in_head and self._head_bytes > MOST_HEAD_BYTES and not self.transport.is_closing():
            self.transport.write(TOO_LARGE)
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        super().send_400_response(msg)
        self._connections.note_closed(self._peer, self.loop.call_later, is_refused=True)

    def on_headers_complete(self) -> None:
        self._is_in_head = False
        self._disarm()
        super().on_headers_complete()

    def on_message_complete(self) -> None:
        self._is_in_head, self._head_bytes = True, 0
        super().on_message_complete()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        if self.cycle.response_complete:  # no pipelined request is waiting
            self._arm()

    def pause_writing(self) -> None:
        super().pause_writing()
        if self._stall is None:
            self._watch()

    def resume_writing(self) -> None:
        super().resume_writing()
        if self._stall is not None:
            self._stall.cancel()
            self._stall = None

    def _watch(self) -> None:
        self._stall = self.loop.call_later(STALL_S, self._look, self.transport.get_write_buffer_size())

    def _look(self, before_bytes: int) -> None:
        """Abort the connection unless its buffer shrank: while writing is paused, nothing is added to it."""
        if self.transport.get_write_buffer_size() < before_bytes:
            self._watch()
        else:
            self.transport.abort()

    def _arm(self) -> None:
        self._disarm()
        self._deadline = self.loop.call_later(self._connections.head_s, self._end)

    def _disarm(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _end(self) -> None:
        """Close the connection, because the time for a head is over."""
        if self.flow.write_paused:  # `pause_writing` limits the wait
            self._arm()
            return
        if not self.transport.is_closing():
            self._close(TOO_SLOW if self._is_in_head and self._head_bytes else b"", is_refused=False)
        self._deadline = self.loop.call_later(STALL_S, self.transport.abort)  # the end may stay unread

    def _close(self, answer: bytes, *, is_refused: bool) -> None:
        self.transport.write(answer)
        self.transport.close()
        self._connections.note_closed(self._peer, self.loop.call_later, is_refused=is_refused)


def _is_no_line_of_a_stranger(record: logging.LogRecord) -> bool:
    """Return False for uvicorn's line about a connection that sends no HTTP; `Connections` counts them."""
    return record.msg != "Invalid HTTP request received."


logging.getLogger("uvicorn.error").addFilter(_is_no_line_of_a_stranger)


def _connections_of(app: Any) -> Connections:
    """Return the connection counts of the application that uvicorn has wrapped."""
    while not hasattr(app, "state"):
        app = app.app
    counts: Connections = app.state.connections
    return counts
