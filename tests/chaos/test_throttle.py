"""The slow line lets through what it is given, slowly one way, and breaks on both sides at once."""

import socket
import time
from collections.abc import Iterator

import pytest

from chaos.throttle import slow_line

SENT = bytes(range(256)) * 1024


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(10.0)
        yield server


def received(connection: socket.socket, size_bytes: int) -> bytes:
    pieces = b""
    while len(pieces) < size_bytes and (piece := connection.recv(65536)):
        pieces += piece
    return pieces


def test_bytes_arrive_as_they_were_sent_and_no_faster_than_the_rate(listener: socket.socket) -> None:
    with slow_line(listener.getsockname(), 1e6) as port, socket.create_connection(("127.0.0.1", port)) as near:
        far, _ = listener.accept()
        with far:
            begun_s = time.monotonic()
            near.sendall(SENT)
            assert received(far, len(SENT)) == SENT
            assert time.monotonic() - begun_s >= 0.7 * len(SENT) / 1e6
            far.sendall(b"answer")
            assert received(near, 6) == b"answer"


def test_a_side_that_goes_away_takes_the_other_with_it(listener: socket.socket) -> None:
    with slow_line(listener.getsockname(), 1e9) as port, socket.create_connection(("127.0.0.1", port)) as near:
        near.settimeout(10.0)
        far, _ = listener.accept()
        far.close()
        assert near.recv(1) == b""
