"""Connections that start a request and then stall: closed in time, counted by address, logged once a minute."""

import resource
import socket
import time
from collections.abc import Callable, Iterator, MutableMapping
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any, cast
from urllib.parse import urlsplit

import httpx
import pytest
from structlog.testing import capture_logs
from uvicorn.protocols.http.flow_control import FlowControl

from api.middleware import heads
from api.middleware.connections import LINE_S, Connections
from services.runtime.platform import Platform
from services.runtime.settings import ApiSettings
from services.runtime.telemetry.descriptors import Descriptors, raise_descriptor_limit
from testing.api.serving import serving
from testing.servers.fixtures import having

PATIENCE_S = 300.0
NOBODY = "192.0.2.1"  # not the address of any test client
LOOPBACK = "127.0.0.1"

Logged = list[MutableMapping[str, Any]]


@contextmanager
def connected(url: str, sent: bytes = b"", source: str = LOOPBACK) -> Iterator[socket.socket]:
    where = urlsplit(url)
    address = (where.hostname or "", where.port or 0)
    with socket.create_connection(address, PATIENCE_S, source_address=(source, 0)) as connection:
        connection.sendall(sent)
        yield connection


def rest_of(connection: socket.socket) -> bytes:
    """Return all bytes received until the server ends the connection, cleanly or not."""
    received = b""
    try:
        while block := connection.recv(65536):
            received += block
    except ConnectionError:
        pass
    return received


@contextmanager
def served(platform: Platform, **api: Any) -> Iterator[str]:
    with serving(having(platform, api={"trusted_proxies": NOBODY, **api})) as url:
        yield url


@pytest.mark.parametrize(
    ("sent", "answer"),
    [(b"", b""), (b"GET /healthz HTTP/1.1\r\nHost: x\r\n", b"HTTP/1.1 408 ")],
    ids=["silent", "half a head"],
)
def test_a_connection_without_a_whole_head_ends(platform: Platform, sent: bytes, answer: bytes) -> None:
    with served(platform, head_s=0.3) as url, connected(url, sent) as connection:
        assert rest_of(connection)[:13] == answer


def test_a_connection_that_was_answered_ends_if_it_begins_another_head(platform: Platform) -> None:
    """uvicorn's own timer ends with the first byte."""
    request = b"GET /healthz HTTP/1.1\r\nHost: x\r\n\r\n"
    with served(platform, head_s=0.3) as url, connected(url, request) as connection:
        assert connection.recv(65536).startswith(b"HTTP/1.1 200 ")
        connection.sendall(b"GET /hea")
        assert b"HTTP/1.1 408 " in rest_of(connection)


def test_what_is_left_of_an_answered_body_is_not_waited_for(platform: Platform) -> None:
    head = b"POST /api/v1/nothing HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\nx"
    with served(platform, head_s=0.3) as url, connected(url, head) as connection:
        assert rest_of(connection).count(b"HTTP/1.1 ") == 1


def test_an_answer_that_nobody_takes_is_cut_off(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    """The client reads nothing until the server has ended the connection: then its address can connect again."""
    monkeypatch.setattr(heads, "STALL_S", 0.5)
    asked = b"GET /api/v1/openapi.json HTTP/1.1\r\nHost: x\r\n\r\n" * 100
    with served(platform, connections_per_address=1) as url, connected(url, asked) as connection:
        assert answered_at_last(url)
        assert rest_of(connection).count(b"HTTP/1.1 200 ") < 100


def test_who_sends_no_http_writes_no_line_each(platform: Platform, caplog: pytest.LogCaptureFixture) -> None:
    with served(platform) as url:
        for _ in range(3):
            with connected(url, b"SSH-2.0-OpenSSH_9.2\r\n\r\n") as connection:
                assert rest_of(connection).startswith(b"HTTP/1.1 400 ")
    assert "Invalid HTTP request" not in caplog.text


def test_one_address_has_so_many_connections_and_others_are_answered(platform: Platform) -> None:
    with served(platform, connections_per_address=4) as url, ExitStack() as stack:
        held = [stack.enter_context(connected(url)) for _ in range(4)]
        with connected(url) as refused:
            assert rest_of(refused).startswith(b"HTTP/1.1 503 ")
        elsewhere = httpx.HTTPTransport(local_address="127.0.0.2")
        with httpx.Client(transport=elsewhere) as other:
            assert other.get(f"{url}/healthz").status_code == 200
        for connection in held:
            connection.close()
        assert answered_at_last(url)


def answered_at_last(url: str) -> bool:
    """Return whether the server answers the address again after it has detected that the other connections ended."""
    for _ in range(3000):
        with connected(url, b"GET /healthz HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n") as connection:
            if rest_of(connection).startswith(b"HTTP/1.1 200 "):
                return True
        time.sleep(0.02)
    return False


class Clock:
    """A monotonic clock that a test advances, and an event loop's `call_later`."""

    def __init__(self) -> None:
        self.now_s, self.due = 1000.0, list[tuple[float, Callable[[], None]]]()

    def __call__(self) -> float:
        return self.now_s

    def call_later(self, after_s: float, act: Callable[..., None], *given: Any) -> bool:
        self.due.append((self.now_s + after_s, partial(act, *given)))
        return True

    def go_on(self, seconds: float) -> None:
        self.now_s += seconds
        ready = [one for one in self.due if one[0] <= self.now_s]
        self.due = [one for one in self.due if one not in ready]
        for _, act in ready:
            act()


@pytest.fixture
def logged() -> Iterator[Logged]:
    with capture_logs() as lines:
        yield lines


class Buffer:
    """A transport whose client reads the response slowly."""

    def __init__(self, size_bytes: int) -> None:
        self.size_bytes, self.is_aborted = size_bytes, False

    def get_write_buffer_size(self) -> int:
        return self.size_bytes

    def abort(self) -> None:
        self.is_aborted = True


def test_a_large_answer_is_not_cut_while_a_slow_client_takes_of_it() -> None:
    clock, buffer = Clock(), Buffer(100)
    connection: Any = heads.BoundedHeads.__new__(heads.BoundedHeads)
    connection.loop, connection.transport, connection.flow = clock, buffer, FlowControl(cast(Any, buffer))
    connection._stall = None
    connection.pause_writing()
    for _ in range(100):
        buffer.size_bytes -= 1
        clock.go_on(heads.STALL_S)
    assert not buffer.is_aborted
    clock.go_on(heads.STALL_S)
    assert buffer.is_aborted


def test_closed_connections_are_told_of_in_one_line_a_minute(logged: Logged) -> None:
    clock = Clock()
    counts = Connections(ApiSettings(), clock)
    for _ in range(150):
        for host in ("2001:db8::1", "2001:db8::2", "198.51.100.7"):
            counts.note_closed(host, clock.call_later, is_refused=True)
        clock.go_on(1.0)
    clock.go_on(LINE_S)
    lines = [line for line in logged if line["log_level"] == "warning"]
    assert [line["count"] for line in lines] == [3, 180, 180, 87]
    assert {line["address"] for line in lines} == {"2001:db8::/64"}
    assert sum(line["of_address"] for line in lines) == 300


def test_a_network_of_ipv6_counts_as_one_and_proxies_do_not_count() -> None:
    counts = Connections(ApiSettings(connections_per_address=2, trusted_proxies="10.1.0.0/16"))
    assert [counts.admit(f"2001:db8::{number}", 9) for number in range(4)] == [True, True, False, False]
    counts.leave("2001:db8::9")
    assert counts.admit("2001:db8::7", 9)
    assert all(counts.admit("10.1.2.3", 9) for _ in range(100))
    assert [counts.admit("10.2.2.3", 9) for _ in range(3)] == [True, True, False]


def test_the_last_open_files_are_told_of_once_a_minute(logged: Logged) -> None:
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    clock = Clock()
    watch = Descriptors(LINE_S, clock)
    watch.look(limit // 2)
    assert not logged
    for _ in range(119):
        watch.look(limit - 1)
        clock.go_on(1.0)
    assert [line["open"] for line in logged] == [limit, limit]


def test_the_limit_of_open_files_is_raised_as_far_as_it_may_be() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(soft, 1024), hard))
    try:
        assert raise_descriptor_limit() == resource.getrlimit(resource.RLIMIT_NOFILE)[0] >= min(hard, 2**20)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
