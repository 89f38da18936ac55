"""Machines that are namespaces: they reach each other by their link only, and not when it is cut."""

import socket
from collections.abc import Iterator

import pytest

from chaos.spaces import Link, Space, two_machines, why_not

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


def test_a_slow_link_still_carries(link: Link) -> None:
    first, second = link.ends
    link.slow(10**6)
    with listening_on(first) as server:
        assert reaches(second, server)
    link.mend()


def test_whoever_left_a_machine_is_where_they_were(link: Link) -> None:
    first, _ = link.ends
    with socket.create_server(("127.0.0.1", 0)) as server:
        with first.entered(), socket.socket() as probe:
            assert probe.connect_ex(server.getsockname()) != 0, "loopback is each machine's own"
        with socket.socket() as probe:
            assert probe.connect_ex(server.getsockname()) == 0
