"""Machines that are namespaces reach each other by their link only; a slow line lets everything through, slowly."""

import socket
import time
from collections.abc import Iterator

import pytest

from chaos.spaces import Link, Space, two_machines, why_not
from chaos.throttle import slow_line

LONG_S = 20.0
SHORT_S = 0.3


@pytest.fixture(scope="module")
def link() -> Iterator[Link]:
    if reason := why_not():
        pytest.skip(f"no network namespaces here: {reason}")
    with two_machines() as made:
        yield made


def listening_on(space: Space) -> socket.socket:
    with space.entered():
        return socket.create_server((space.address, 0))


def reaches(source: Space, server: socket.socket, within_s: float = LONG_S) -> bool:
    """An address is asked for once a second until it is answered: a second's patience is none beside other load."""
    with source.entered(), socket.socket() as probe:
        probe.settimeout(within_s)
        return probe.connect_ex(server.getsockname()) == 0


def test_one_machine_reaches_the_other_unless_the_link_is_cut(link: Link) -> None:
    first, second = link.ends
    with listening_on(first) as server:
        assert reaches(second, server)
        link.cut()
        assert not reaches(second, server, within_s=SHORT_S)
        link.mend()
        assert reaches(second, server)


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
