"""Where a demo goes: to a server as whoever signed in there, with the benchmark's part if they may administrate."""

import pytest

from services.runtime.platform import Platform
from stone_client.credentials import Server
from stone_local.demo.server import demo_server_of
from testing.api.serving import person, serving


@pytest.mark.parametrize(("role", "administers"), [("administrator", True), ("curator", False)])
def test_the_benchmark_is_made_by_whoever_may_administrate(platform: Platform, role: str, administers: bool) -> None:
    somebody = person(platform, role)
    with serving(platform) as url:
        place = demo_server_of(Server(url, somebody.secret))
        assert place.server == Server(url, somebody.secret)
        with place.administering() as api:
            assert (api is not None) == administers
            if api is not None:
                assert api.read("/me")["role"] == role
