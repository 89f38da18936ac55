"""A slow line between a client and the API, so that a kill can hit the middle of a request.

**Conventions.** Bytes towards the API are forwarded at a limited rate, replies at once; a connection that breaks on one
side is broken on the other. No byte is read or changed on the way.
"""

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from threading import Thread

PIECE_BYTES = 64 * 1024


@contextmanager
def slow_line(address: tuple[str, int], bytes_per_s: float) -> Iterator[int]:
    """Yield the port of 127.0.0.1 that leads to `address`."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        Thread(target=_accept, args=(listener, address, bytes_per_s), name="slow line", daemon=True).start()
        yield int(listener.getsockname()[1])


def _accept(listener: socket.socket, address: tuple[str, int], bytes_per_s: float) -> None:
    with suppress(OSError):
        while True:
            near, _ = listener.accept()
            try:
                far = socket.create_connection(address, timeout=10.0)
            except OSError:
                near.close()
                continue
            far.settimeout(None)
            for source, sink, rate in ((near, far, bytes_per_s), (far, near, float("inf"))):
                Thread(target=_carry, args=(source, sink, rate), name="slow line", daemon=True).start()


def _carry(source: socket.socket, sink: socket.socket, bytes_per_s: float) -> None:
    """Forward bytes until either side ends or breaks; then close both."""
    with suppress(OSError):
        while piece := source.recv(PIECE_BYTES):
            sink.sendall(piece)
            time.sleep(len(piece) / bytes_per_s)
    for end in (source, sink):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)
        end.close()
