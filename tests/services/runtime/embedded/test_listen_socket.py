"""The API's socket: bound by the supervisor, refused with its name where it cannot be."""

import socket

import pytest

from services.runtime.embedded.errors import PortTakenError
from services.runtime.embedded.listen_socket import listen, local_url, reached_at
from services.runtime.settings import ApiSettings


def test_a_taken_port_is_refused_by_name() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(PortTakenError, match=rf"cannot listen on 127.0.0.1 port {port}: Address already in use"):
            listen(ApiSettings(port=port))


@pytest.mark.parametrize("host", ["192.0.2.1", "nowhere.invalid"])
def test_a_host_that_is_not_ours_is_refused(host: str) -> None:
    with pytest.raises(PortTakenError, match=host):
        listen(ApiSettings(host=host, port=0))


def test_port_0_becomes_the_port_that_was_free() -> None:
    with listen(ApiSettings(port=0)) as listener:
        api = reached_at(ApiSettings(port=0), listener)
        assert api.port == listener.getsockname()[1] > 0
        assert api.url == f"http://127.0.0.1:{api.port}"


def test_a_url_that_was_set_is_kept() -> None:
    with listen(ApiSettings(port=0)) as listener:
        assert reached_at(ApiSettings(port=0, url="https://stone.example"), listener).url == "https://stone.example"


@pytest.mark.parametrize(
    ("host", "url"),
    [("0.0.0.0", "http://127.0.0.1:80"), ("::", "http://[::1]:80"), ("robot", "http://robot:80")],
)
def test_a_server_that_listens_everywhere_is_reached_locally(host: str, url: str) -> None:
    assert local_url(host, 80) == url
