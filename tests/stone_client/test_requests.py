"""Requests to a server: which one is meant, what is sent again and what is not, what is told of refusals and events."""

import json
import stat
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from stone_base.releases import HEADER
from stone_client.api import Api
from stone_client.credentials import (
    Server,
    choose_server,
    configuration_folder,
    is_local,
    plain_url,
    remember,
)
from stone_client.errors import ServerFaultError, ServerRefusedError, ServerUnreachableError
from stone_client.release import OLDEST_SERVER, own_release
from stone_client.server.job_following import Event, events
from testing.refusals import refused_as

Answer = tuple[int, dict[str, str], bytes]
DONE: Answer = (200, {}, b'{"items": [1], "next": null}')
AWAY: Answer = (503, {"Retry-After": "0"}, b'{"code": "database_unavailable", "detail": "later"}')
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
    slow: Answer = (503, {"Retry-After": "60"}, b'{"code": "database_unavailable", "detail": "later"}')
    with scripted(slow) as script, Api(Server(script.url, "t"), patience_s=1.0) as api:
        with pytest.raises(ServerRefusedError, match="later") as refused:
            api.read("/sequences")
        assert (refused.value.code, refused.value.status, len(script.heard)) == ("database_unavailable", 503, 1)


@pytest.mark.parametrize(("status", "request_said"), [(422, ""), (500, " (request abc)")])
def test_a_refusal_keeps_the_servers_code_sentence_and_findings_and_a_fault_its_request(
    status: int, request_said: str
) -> None:
    with (
        scripted((status, {}, json.dumps(PROBLEM).encode())) as script,
        Api(Server(script.url, "t")) as api,
        pytest.raises(ServerRefusedError) as refused,
    ):
        api.create("/sequences", {})
    assert refused.value.code == "invalid_request"
    assert str(refused.value) == f"2 things are not as asked: body.name: Field required{request_said}"


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


@pytest.mark.parametrize("release", ["", OLDEST_SERVER, "999.1.0", "banana"])
def test_a_server_that_is_new_enough_or_says_nothing_is_understood_and_told_our_release(release: str) -> None:
    with scripted((200, {HEADER: release} if release else {}, b"{}")) as script, Api(Server(script.url, "t")) as api:
        assert api.read("/me") == {}
    assert [headers[HEADER] for _, _, headers in script.heard] == [own_release()]


def test_a_server_that_is_too_old_is_refused_whether_read_at_once_or_as_it_comes() -> None:
    with scripted((200, {HEADER: "0.0.9"}, b"{}")) as script, Api(Server(script.url, "t")) as api:
        with refused_as("server_too_old", match=rf"release 0\.0\.9, .* {OLDEST_SERVER} or newer; .*/downloads/"):
            api.read("/me")
        with refused_as("server_too_old"), api.stream("/events"):
            pass


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("data: one\n\n", [Event("message", "", "one")]),
        ("event: job\nid: 7\ndata: {}\n\n", [Event("job", "7", "{}")]),
        ("data: one\ndata: two\n\n", [Event("message", "", "one\ntwo")]),
        ("data:  two spaces\n\n", [Event("message", "", " two spaces")]),
        (": still here\n\ndata:x\n\n", [Event("message", "", "x")]),
        ("event: empty\n\ndata: x\n\n", [Event("message", "", "x")]),
        ("id: 7\ndata: a\n\ndata: b\n\n", [Event("message", "7", "a"), Event("message", "7", "b")]),
        ("retry: 10\ndata\ndata: x\n\n", [Event("message", "", "\nx")]),
        ("data: cut off", []),
    ],
)
def test_fields_make_events(text: str, expected: list[Event]) -> None:
    assert list(events(text.splitlines())) == expected


HOME = "http://127.0.0.1:8080"
ELSEWHERE = "https://stone.example"


@pytest.fixture(autouse=True)
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STONE_URL", "STONE_TOKEN", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))


def test_without_any_server_the_refusal_says_how_to_name_one() -> None:
    with refused_as("no_server", match="stone auth login URL"):
        choose_server()


def test_a_server_without_a_token_is_refused_by_name() -> None:
    with refused_as("not_signed_in", match=f"stone auth login {ELSEWHERE}"):
        choose_server(ELSEWHERE)


@pytest.mark.parametrize("content", ["{", "[]", '{"servers": {"x": 1}}', '{"servers": []}'])
def test_a_file_changed_by_hand_is_refused_not_overwritten(content: str) -> None:
    path = configuration_folder() / "credentials.json"
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with refused_as("bad_credentials_file", match=r"credentials\.json"):
        remember(HOME, "stone_1", as_default=True)
    assert path.read_text() == content


@pytest.mark.parametrize("url", ["ftp://stone.example", "http://", "http://a:b@c", "http://host:port", "http://h/path"])
def test_what_is_no_servers_address_is_refused(url: str) -> None:
    with refused_as("bad_url"):
        plain_url(url)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("127.0.0.1:8080", HOME),
        ("https://stone.example/", ELSEWHERE),
        ("HTTPS://Stone.Example", ELSEWHERE),
        ("http://[::1]:80", "http://[::1]:80"),
    ],
)
def test_an_address_is_read_as_people_type_it(typed: str, meant: str) -> None:
    assert plain_url(typed) == meant


def test_the_file_is_for_its_owners_eyes_only() -> None:
    remember(HOME, "stone_1", as_default=True)
    path = configuration_folder() / "credentials.json"
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert json.loads(path.read_text())["default"] == HOME


def test_what_is_typed_comes_before_the_environment_and_that_before_what_is_remembered(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    remember(HOME, "stone_home", as_default=True)
    remember(ELSEWHERE, "stone_away", as_default=False)
    assert choose_server() == Server(HOME, "stone_home")
    assert choose_server(ELSEWHERE) == Server(ELSEWHERE, "stone_away")
    monkeypatch.setenv("STONE_URL", ELSEWHERE)
    assert choose_server() == Server(ELSEWHERE, "stone_away")
    assert choose_server(HOME) == Server(HOME, "stone_home")
    monkeypatch.setenv("STONE_TOKEN", "stone_given")
    assert choose_server() == Server(ELSEWHERE, "stone_given")


def test_a_token_is_not_shown_by_accident() -> None:
    assert "stone_secret" not in repr(Server(HOME, "stone_secret"))


@pytest.mark.parametrize(("url", "is_ours"), [(HOME, True), ("http://localhost:1", True), (ELSEWHERE, False)])
def test_a_server_on_this_machine_is_told_from_others(url: str, is_ours: bool) -> None:
    assert is_local(url) is is_ours
