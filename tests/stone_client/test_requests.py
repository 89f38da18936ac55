"""Requests to a server that answers as told: what may be sent again is, what may not is not, refusals keep theirs."""

import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerFaultError, ServerRefusedError, ServerUnreachableError

Answer = tuple[int, dict[str, str], bytes]
DONE: Answer = (200, {}, b'{"items": [1], "next": null}')
AWAY: Answer = (503, {"Retry-After": "0"}, b'{"code": "database_away", "detail": "later"}')
BROKEN: Answer = (0, {}, b"")  # the connection ends without an answer
PROBLEM = {
    "code": "invalid_request",
    "detail": "2 things are not as asked",
    "request_id": "abc",
    "errors": [{"code": "missing", "where": "body.name", "expected": "Field required"}],
}


@dataclass
class Scripted:
    """A server that gives these answers, the last one for ever."""

    answers: list[Answer]
    heard: list[tuple[str, str, dict[str, str]]] = field(default_factory=list)
    url: str = ""


@contextmanager
def scripted(*answers: Answer) -> Iterator[Scripted]:
    script = Scripted(list(answers))

    class Handler(BaseHTTPRequestHandler):
        def answer(self) -> None:
            script.heard.append((self.command, self.path, dict(self.headers)))
            self.rfile.read(int(self.headers.get("Content-Length", "0")))
            status, headers, body = script.answers.pop(0) if len(script.answers) > 1 else script.answers[0]
            if not status:
                self.close_connection = True
                return
            self.send_response(status)
            for name, value in (headers | {"Content-Length": str(len(body))}).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(body)

        do_GET = do_POST = do_PUT = do_PATCH = answer  # noqa: N815 - http.server's own names

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    try:
        script.url = f"http://127.0.0.1:{server.server_address[1]}"
        yield script
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize("trouble", [AWAY, BROKEN, (429, {"Retry-After": "0"}, b"{}")], ids=["503", "broken", "429"])
def test_reading_is_tried_again(trouble: Answer) -> None:
    with scripted(trouble, trouble, DONE) as script, Api(Server(script.url, "t")) as api:
        assert api.read("/sequences")["items"] == [1]
    assert len(script.heard) == 3


def test_creating_is_tried_again_under_the_same_key() -> None:
    with scripted(BROKEN, AWAY, DONE) as script, Api(Server(script.url, "t")) as api:
        api.create("/sequences", {"name": "run"})
    assert len({headers["Idempotency-Key"] for _, _, headers in script.heard}) == 1
    assert len(script.heard) == 3


def test_what_might_be_done_twice_is_not_sent_again() -> None:
    with scripted(BROKEN, DONE) as script, Api(Server(script.url, "t")) as api:
        with pytest.raises(ServerUnreachableError):
            api.send("PATCH", "/uploads/1", content=b"x")
        assert len(script.heard) == 1


def test_patience_ends() -> None:
    slow: Answer = (503, {"Retry-After": "60"}, b'{"code": "database_away", "detail": "later"}')
    with scripted(slow) as script, Api(Server(script.url, "t"), patience_s=1.0) as api:
        with pytest.raises(ServerRefusedError, match="later") as refused:
            api.read("/sequences")
        assert (refused.value.code, refused.value.status, len(script.heard)) == ("database_away", 503, 1)


def test_a_refusal_keeps_the_servers_code_sentence_findings_and_request() -> None:
    with (
        scripted((422, {}, json.dumps(PROBLEM).encode())) as script,
        Api(Server(script.url, "t")) as api,
        pytest.raises(ServerRefusedError) as refused,
    ):
        api.create("/sequences", {})
    assert refused.value.code == "invalid_request"
    assert str(refused.value) == "2 things are not as asked: body.name: Field required (request abc)"


@pytest.mark.parametrize("body", [b"<html>Sign in</html>", b"[]", b'"text"', b'{"detail": "x"}'])
def test_an_answer_that_is_not_the_platforms_is_called_so(body: bytes) -> None:
    with (
        scripted((404, {}, body)) as script,
        Api(Server(script.url, "t")) as api,
        pytest.raises(ServerFaultError, match="answered 404"),
    ):
        api.read("/sequences")


def test_a_server_that_is_not_there_is_unreachable() -> None:
    with (
        Api(Server("http://127.0.0.1:9", "t"), patience_s=0.0) as api,
        pytest.raises(ServerUnreachableError, match=":9"),
    ):
        api.read("/me")


def test_the_token_goes_to_its_own_server_only() -> None:
    with scripted(DONE) as script, scripted(DONE) as other, Api(Server(script.url, "stone_x")) as api:
        api.send("GET", f"{other.url}/api/v1/uploads/1")
    assert other.heard == []
    assert script.heard[0][1] == "/api/v1/uploads/1"
    assert script.heard[0][2]["Authorization"] == "Bearer stone_x"


def test_a_proxy_of_the_environment_is_not_asked_for_this_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    with scripted(DONE) as script:
        monkeypatch.setenv("HTTP_PROXY", "http://127.0.0.1:9")
        monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
        with Api(Server(script.url, "t"), patience_s=0.0) as api:
            assert api.read("/me")


def test_every_page_of_a_list_is_read() -> None:
    first: Answer = (200, {}, b'{"items": [1, 2], "next": "c2"}')
    with scripted(first, DONE) as script, Api(Server(script.url, "t")) as api:
        assert list(api.pages("/sequences", name="a b")) == [1, 2, 1]
    assert "cursor=c2" in script.heard[1][1]
    assert all("name=a" in path for _, path, _ in script.heard)
