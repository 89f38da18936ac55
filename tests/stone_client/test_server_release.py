"""A server that is too old for this client is refused with what to do; one that says no release is understood."""

from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from threading import Thread

import pytest

from stone_base.releases import HEADER
from stone_client.api import Api
from stone_client.credentials import Server
from stone_client.errors import ServerTooOldError
from stone_client.release import OLDEST_SERVER, own_release


@contextmanager
def server_of(release: str, heard: list[str]) -> Iterator[str]:
    """The URL of a server that says this release and answers everything with an empty object."""

    class Answers(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            heard.append(self.headers.get(HEADER, ""))
            self.send_response(200)
            if release:
                self.send_header(HEADER, release)
            self.send_header("Content-Length", "2")
            self.end_headers()
            self.wfile.write(b"{}")

        def log_message(self, format: str, *args: object) -> None:
            """Nothing is said."""

    with ThreadingHTTPServer(("127.0.0.1", 0), Answers) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


@pytest.mark.parametrize("release", ["", OLDEST_SERVER, "999.1.0", "banana"])
def test_a_server_that_is_new_enough_or_says_nothing_is_understood_and_told_our_release(release: str) -> None:
    heard: list[str] = []
    with server_of(release, heard) as url, Api(Server(url, "token")) as api:
        assert api.read("/me") == {}
    assert heard == [own_release()]


def test_a_server_that_is_too_old_is_refused_whether_read_at_once_or_as_it_comes() -> None:
    with server_of("0.0.9", []) as url, Api(Server(url, "token")) as api:
        with pytest.raises(ServerTooOldError, match=rf"release 0\.0\.9, .* {OLDEST_SERVER} and newer; .*/downloads/"):
            api.read("/me")
        with pytest.raises(ServerTooOldError), api.stream("/events"):
            pass
