"""Bodies that never arrive, and bodies of unknown senders: bounded in time, size and memory before they are read."""

import asyncio
import json
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import httpx
import pytest
from starlette.requests import ClientDisconnect, Request
from starlette.types import Message, Receive, Scope, Send

from api.main import make_api
from api.middleware.bodies import STRANGERS_BYTES, BodyLimit
from api.middleware.held_bytes import OVERHEAD_BYTES, SHARES
from api.openapi import operations
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import having
from tests.api.test_connections import connected, rest_of, served

JSON = "Content-Type: application/json\r\n"
MIB = 2**20


def head(path: str, size_bytes: int, more: str = JSON) -> bytes:
    return f"POST /api/v1/{path} HTTP/1.1\r\nHost: x\r\nContent-Length: {size_bytes}\r\n{more}\r\n".encode()


def credential_of(caller: Person) -> str:
    return "".join(f"{name}: {value}\r\n" for name, value in caller.headers.items())


def problem_in(answer: bytes) -> tuple[int, str]:
    start, _, body = answer.partition(b"\r\n\r\n")
    return int(start.split(b" ", 2)[1]), json.loads(body)["code"]


@pytest.mark.parametrize("key", ["", "Idempotency-Key: k\r\n"], ids=["alone", "idempotent"])
def test_a_body_that_stops_is_refused_and_its_connection_ends(platform: Platform, curator: Person, key: str) -> None:
    sent = head("teams", 100, JSON + credential_of(curator) + key) + b'{"name":'
    with served(platform, body_s=0.3) as url, connected(url, sent) as connection:
        assert problem_in(rest_of(connection)) == (408, "body_too_slow")


def test_a_body_that_trickles_is_refused(platform: Platform, curator: Person) -> None:
    """Each byte arrives in time, but the whole body would not."""
    stop = threading.Event()
    with (
        served(platform, body_s=0.5) as url,
        connected(url, head("teams", 100_000, JSON + credential_of(curator))) as connection,
    ):

        def trickle() -> None:
            while not stop.wait(0.05):
                try:
                    connection.sendall(b" ")
                except OSError:
                    return

        sender = threading.Thread(target=trickle)
        sender.start()
        try:
            assert problem_in(rest_of(connection)) == (408, "body_too_slow")
        finally:
            stop.set()
            sender.join()


def test_a_form_that_stops_is_refused(platform: Platform, curator: Person) -> None:
    kind = "Content-Type: multipart/form-data; boundary=B\r\n"
    sent = head("uploads/form", 1000, kind + credential_of(curator)) + b"--B\r\n"
    quick = having(platform, uploads={"idle_s": 0.3})
    with served(quick) as url, connected(url, sent) as connection:
        assert problem_in(rest_of(connection)) == (408, "body_too_slow")


def test_what_a_stranger_sends_is_refused_unread(platform: Platform) -> None:
    """The rest of the body never arrives: a response shows that the server did not wait for it."""
    with served(platform) as url:
        for path in ("teams", "sequences", "calibrations", "tokens", "uploads/form", "device-grants/decision"):
            for false in ("", "Authorization: Bearer stone_false\r\n"):
                with connected(url, head(path, 2 * MIB, JSON + false) + b" " * 1000) as connection:
                    assert connection.recv(65536).startswith(b"HTTP/1.1 401 "), path


def test_a_stranger_who_signs_in_has_a_small_body(platform: Platform) -> None:
    with served(platform) as url:
        for path in ("sessions", "device-grants", "device-grants/token"):
            with connected(url, head(path, STRANGERS_BYTES + 1)) as connection:
                assert connection.recv(65536).startswith(b"HTTP/1.1 413 "), path
            chunked = f"POST /api/v1/{path} HTTP/1.1\r\nHost: x\r\nTransfer-Encoding: chunked\r\n{JSON}\r\n"
            with connected(url, chunked.encode() + b"5000\r\n" + b" " * 0x5000) as connection:
                assert connection.recv(65536).startswith(b"HTTP/1.1 413 "), path


def test_strangers_send_bodies_where_the_document_names_no_credential(platform: Platform) -> None:
    app = make_api(platform)
    (limit,) = [one for one in app.user_middleware if getattr(one.cls, "__name__", "") == BodyLimit.__name__]
    documented = {
        (method.upper(), path)
        for path, method, operation in operations(app.openapi())
        if "requestBody" in operation and "security" not in operation
    }
    assert limit.kwargs["strangers"] == documented != set()


@pytest.fixture
def narrow(platform: Platform) -> Platform:
    """Return a platform with room for one body's overhead and a little more per sender, and for four times as much."""
    return having(platform, api={"held_body_bytes": SHARES * 2 * MIB, "body_bytes": MIB})


def test_bodies_under_way_have_a_budget_which_is_given_back(narrow: Platform, curator: Person) -> None:
    piece = MIB // 2
    large = head("teams", piece + 1, JSON + credential_of(curator)) + b" " * piece
    with client_of(narrow, curator) as api, ExitStack() as stack:
        url = str(api.base_url)
        held = [stack.enter_context(connected(url, large)) for _ in range(3)]
        refused = refusal_at_last(url, large)
        assert (refused.status, refused.code) == (503, "busy")
        assert "retry-after" in refused.headers
        other = {**person(narrow, "curator").headers, "Content-Type": "application/json"}
        assert api.post("/api/v1/teams", content=b" " * piece, headers=other).status_code == 422  # its own share
        for connection in held:
            connection.close()
        assert answered_at_last(api, piece)


class Refusal:
    def __init__(self, answer: bytes) -> None:
        self.status, self.code = problem_in(answer)
        self.headers = answer.partition(b"\r\n\r\n")[0].decode("latin-1").lower()


def refusal_at_last(url: str, sent: bytes) -> Refusal:
    """Return the response to the first body that is refused, after the others have arrived."""
    with ExitStack() as stack:
        for _ in range(100):
            connection = stack.enter_context(connected(url, sent))
            connection.settimeout(0.5)
            try:
                return Refusal(connection.recv(65536))
            except TimeoutError:
                continue
    raise AssertionError("nothing was refused")


def answered_at_last(api: httpx.Client, size_bytes: int) -> bool:
    for _ in range(3000):
        answer = api.post("/api/v1/teams", content=b" " * size_bytes, headers={"Content-Type": "application/json"})
        if answer.status_code == 422:
            return True
        assert answer.status_code == 503
    return False


def bounded(platform: Platform, app: Any) -> BodyLimit:
    return BodyLimit(app, platform.settings, {("POST", "/open")})


def scope_of(host: str = "192.0.2.7") -> Scope:
    headers = [(b"content-length", b"100")]
    return {"type": "http", "method": "POST", "path": "/open", "headers": headers, "client": (host, 1)}


async def unheard(_: Message) -> None:
    """Drop the message."""


@pytest.mark.parametrize("end", ["answered", "failed", "left", "cancelled"])
def test_held_bytes_are_given_back_however_a_request_ends(platform: Platform, end: str) -> None:
    held = list[int]()

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        request = Request(scope, receive)
        stream = request.stream()
        assert await anext(stream) == b"x" * 60
        held.append(limit.budget.held_bytes)
        if end == "failed":
            raise ZeroDivisionError
        async for _ in stream:
            held.append(limit.budget.held_bytes)

    async def receive() -> Message:
        if not held:
            return {"type": "http.request", "body": b"x" * 60, "more_body": True}
        if end == "cancelled":
            await asyncio.sleep(3600)
        if end == "left":
            return {"type": "http.disconnect"}
        return {"type": "http.request", "body": b"x" * 40, "more_body": False}

    async def asked() -> None:
        task = asyncio.ensure_future(limit(scope_of(), receive, unheard))
        while not held:
            await asyncio.sleep(0)
        if end == "cancelled":
            task.cancel()
        await task

    limit = bounded(platform, app)
    expected = {"failed": ZeroDivisionError, "left": ClientDisconnect, "cancelled": asyncio.CancelledError}
    with ThreadPoolExecutor(1) as apart:  # a browser's test may have left a running loop in this thread
        ended = apart.submit(asyncio.run, asked())
    assert isinstance(ended.exception(), expected.get(end, type(None)))
    assert held[0] == OVERHEAD_BYTES + 60
    assert limit.budget.held_bytes == 0
