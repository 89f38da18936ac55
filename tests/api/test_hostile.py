"""Requests that nobody honest sends: none is a fault, none is believed, none costs more than it may.

**Conventions.** Sent as bytes over a socket, since a client would tidy them up.

Catches alone what strange bytes do to a route, of all there are, and to the socket before it.
"""

import re
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import httpx
import pytest

from api.middleware.bodies import STRANGERS_BYTES
from services.runtime.database.migrate import upgrade
from services.runtime.settings import ApiSettings
from testing.api.serving import client_of
from testing.servers.fixtures import make_settings, opened
from tests.api.access.cast import Cast, make_cast
from tests.api.access.world import World, make_world

pytestmark = pytest.mark.whole

PATIENCE_S = 300.0
IDS = ("%00", "a%00b", "x" * 10_000, "%C3%A9", "%2f", "..%2f..%2fetc%2fpasswd", "%2e%2e", "%20", "%0d%0aX:%20y", "%FF",
       "%ED%A0%80", "A" * 32, "%D9%A0" * 32, "'%20OR%201=1--", "0" * 31, "0" * 33, "0" * 32 + "%0a")  # fmt: skip
RANGES = ("bytes=-0", "bytes=5-2", "bytes=0-0,2-3", "bytes=9999999999999999999999-", "bytes=a-b", "bytes=", "items=0-1",
          "bytes=0-" + "9" * 5000, "bytes=" + "0-1," * 2000, "bytes=²-³")  # fmt: skip
TAGS = ('""', 'W/"1"', '"' * 5000, "ÿ", "," * 3000, "W/*", '"99999999999999999999"')
BODIES = (b"[" * 100_000, b'{"a":' * 100_000, b'{"name":NaN}', b'{"name":1e999}', b'{"name":' + b"9" * 10_000 + b"}",
          b"\xff\xfe", b"", b"null", b'{"name":"\\ud800"}', b'{"name":"\\u0000"}', b'{"name":"x"' * 3,
          b'{"name":"\xed\xa0\x80"}', b'{"":1}')  # fmt: skip
NUL_NAME = b'Content-Disposition: form-data; name="file"; filename="a\0b"'
FORMS = (
    b"garbage" * 100, b"--B\r\n", b"--B\r\n" + NUL_NAME + b"\r\n\r\nx\r\n--B--", b"--B\r\nX: y\r\n\r\nabc\r\n--B--\r\n",
    b"--B\r\n" + b"X: y\r\n" * 5000,
)  # fmt: skip


class Wire:
    """One server, spoken to in bytes."""

    def __init__(self, client: httpx.Client, cast: Cast, world: World) -> None:
        self.client, self.cast, self.named = client, cast, world.named

    def status(self, method: str, path: str, *headers: str, body: bytes = b"", caller: str = "owner") -> int:
        credential = [f"{name}: {value}" for name, value in self.cast.headers[caller].items()]
        lines = [f"{method} {path} HTTP/1.1", "Host: x", "Connection: close", f"Content-Length: {len(body)}"]
        head = "\r\n".join([*lines, *credential, *headers]) + "\r\n\r\n"
        return status_of(self.answer(head.encode("latin-1") + body))

    def answer(self, sent: bytes) -> bytes:
        """Whatever comes back until the server ends the connection."""
        with self.connected() as connection:
            connection.sendall(sent)
            return b"".join(iter(lambda: connection.recv(65536), b""))

    @contextmanager
    def connected(self) -> Iterator[socket.socket]:
        url = self.client.base_url
        with socket.create_connection((url.host, url.port or 80), timeout=PATIENCE_S) as connection:
            yield connection


def status_of(answer: bytes) -> int:
    return int(answer.split(b" ", 2)[1])


@pytest.fixture(scope="module")
def wire(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Wire]:
    unbound = ApiSettings(requests_per_minute=10**7, sign_ins_per_minute=10**7)
    platform = opened(make_settings(tmp_path_factory.mktemp("hostile"), api=unbound), [])
    upgrade(platform.settings)
    cast = make_cast(platform)
    with client_of(platform) as client:
        yield Wire(client, cast, make_world(platform, cast.users["owner"]))
    platform.database.close()


def test_an_id_that_cannot_be_one_names_nothing(wire: Wire) -> None:
    for template in ["/api/v1/sequences/{}", "/api/v1/jobs/{}/events", "/api/v1/frames/{}", "/api/v1/problems/{}"]:
        answers = {one[:40]: wire.status("GET", template.format(one)) for one in IDS}
        assert set(answers.values()) <= {404, 422}, answers


def test_a_slash_too_many_leads_nowhere(wire: Wire) -> None:
    """A redirect would go to the host that the request names."""
    for path in ["/api/v1/sequences/", "/api/v1//sequences", "/healthz/", "//evil.example/api/v1/me"]:
        assert wire.status("GET", path) == 404


def test_a_range_that_is_none_costs_no_more_than_the_file(wire: Wire) -> None:
    for asked in RANGES:
        assert wire.status("GET", f"/api/v1/frames/{wire.named['token']}/labels.npz", f"Range: {asked}") in (200, 416)


def test_a_tag_that_is_none_changes_nothing(wire: Wire) -> None:
    for tag in TAGS:
        assert wire.status("DELETE", f"/api/v1/sequences/{wire.named['sequence_id']}", f"If-Match: {tag}") == 412


def test_a_body_that_is_a_trap_is_refused(wire: Wire) -> None:
    for path in ["sequences", "tokens", "sequences/{sequence_id}/process", "sessions"]:
        where = f"/api/v1/{path}".format_map(wire.named)
        bodies = [one for one in BODIES if path != "sessions" or len(one) <= STRANGERS_BYTES]
        answers = [wire.status("POST", where, "Content-Type: application/json", body=body) for body in bodies]
        assert set(answers) <= {400, 422}, answers


def test_a_form_that_is_none_is_refused(wire: Wire) -> None:
    for path in ["/api/v1/uploads/form", "/api/v1/calibrations"]:
        kind = "Content-Type: multipart/form-data; boundary=B"
        assert {wire.status("POST", path, kind, body=body) for body in FORMS} <= {400, 422}
        assert wire.status("POST", path, "Content-Type: multipart/form-data", body=b"x") in (400, 422)


def test_a_name_that_would_pass_for_another_is_refused(wire: Wire) -> None:
    for name in ["a\u202eb", "\u200b", "a\u2066b", "a\u0085b", "\ufeffa", "a\u2028b"]:
        for path in ("teams", "tokens"):
            answer = wire.client.post(f"/api/v1/{path}", json={"name": name}, headers=wire.cast.headers["owner"])
            assert answer.status_code == 422, path


def test_a_head_without_end_is_cut_off(wire: Wire) -> None:
    """Without the bound the server keeps all of it, and nobody has asked yet who calls."""
    with wire.connected() as connection:
        connection.sendall(b"GET /healthz HTTP/1.1\r\nX: ")
        with pytest.raises(ConnectionError):
            connection.sendall(b"y" * 64 * 2**20)
    assert wire.client.get("/healthz").status_code == 200


def test_many_heads_on_one_connection_are_each_counted_alone(wire: Wire) -> None:
    request = b"GET /healthz HTTP/1.1\r\nHost: x\r\nX: " + b"y" * 40_000 + b"\r\n"
    answers = wire.answer((request + b"\r\n") * 4 + request + b"Connection: close\r\n\r\n")
    assert len(re.findall(rb"HTTP/1.1 200", answers)) == 5


def test_a_body_of_two_lengths_is_no_request(wire: Wire) -> None:
    smuggled = b"POST /api/v1/teams HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n"
    assert status_of(wire.answer(smuggled + b"0\r\n\r\nGET /healthz HTTP/1.1\r\n\r\n")) == 400


def test_a_flood_of_streams_is_bounded_and_leaves_room_for_others(wire: Wire) -> None:
    path = f"/api/v1/jobs/{wire.named['job_id']}/events"
    head = f"GET {path} HTTP/1.1\r\nHost: x\r\nAuthorization: {wire.cast.headers['owner']['Authorization']}\r\n\r\n"
    opened = []
    for _ in range(30):
        connection = socket.create_connection((wire.client.base_url.host, wire.client.base_url.port or 80), PATIENCE_S)
        connection.sendall(head.encode())
        opened.append(connection)
    statuses = [status_of(connection.recv(64)) for connection in opened]
    assert wire.client.get("/api/v1/me", headers=wire.cast.headers["other"]).status_code == 200
    for connection in opened:
        connection.close()
    assert statuses.count(200) == 8
    assert statuses.count(429) == 22
