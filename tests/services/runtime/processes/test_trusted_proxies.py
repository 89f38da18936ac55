"""Who asks is the right-most address that no proxy of ours has: what stands left of it, anybody can write."""

from ipaddress import IPv4Address, IPv6Address
from typing import Any

import pytest
import uvicorn
from hypothesis import given
from hypothesis import strategies as st
from uvicorn.middleware.proxy_headers import ProxyHeadersMiddleware

from services.runtime.processes.api import options
from services.runtime.settings import ApiSettings, Settings
from testing.refusals import refused_as

TRUSTED = "10.1.0.0/16, 192.0.2.7 2001:db8:7::/48"
in_ours = st.one_of(
    st.integers(0, 2**16 - 1).map(lambda low: str(IPv4Address("10.1.0.0") + low)),
    st.just("192.0.2.7"),
    st.integers(0, 2**80 - 1).map(lambda low: str(IPv6Address("2001:db8:7::") + low)),
)
in_the_world = st.one_of(
    st.integers(0, 2**24 - 1).map(lambda low: str(IPv4Address("203.0.0.0") + low)),
    st.integers(0, 2**80 - 1).map(lambda low: str(IPv6Address("2001:db8:8::") + low)),
)
anything = st.text(st.characters(codec="latin-1", exclude_categories=["Cc"]), max_size=40)
forgery = st.lists(st.one_of(anything, in_ours, in_the_world), max_size=4)


def client_seen(settings: Settings, peer: str, lines: list[str]) -> str:
    """The address that the application is told, by uvicorn as the API's process runs it; a header for each line."""
    seen: list[str] = []

    async def application(scope: Any, _receive: Any, _send: Any) -> None:
        seen.append(scope["client"][0])

    said = options(settings, 1) | {"factory": False, "loop": "asyncio", "log_config": None}
    config = uvicorn.Config(application, **said)
    config.load()
    assert isinstance(config.loaded_app, ProxyHeadersMiddleware)
    headers = [(b"x-forwarded-for", line.encode("latin-1")) for line in lines]
    asking: Any = config.loaded_app({"type": "http", "client": (peer, 1), "headers": headers}, None, None)  # type: ignore[arg-type,typeddict-item]
    with pytest.raises(StopIteration):  # nothing in it waits, so it needs no loop, and may be asked within one
        asking.send(None)
    return seen[0]


def behind(proxies: str) -> Settings:
    return Settings(api=ApiSettings(trusted_proxies=proxies))


@pytest.mark.whole
@given(forgery, in_the_world, st.lists(in_ours, max_size=3), in_ours)
def test_whatever_a_client_writes_it_is_who_it_is(
    forged: list[str], client: str, between: list[str], peer: str
) -> None:
    """Each proxy appends the address of whoever asked it; the first of them that of the client."""
    assert client_seen(behind(TRUSTED), peer, [", ".join([*forged, client, *between])]) == client


@given(forgery, in_the_world, in_ours)
def test_a_header_of_its_own_for_each_proxy_is_the_same(forged: list[str], client: str, peer: str) -> None:
    assert client_seen(behind(TRUSTED), peer, [*forged, client]) == client


@given(forgery, in_the_world)
def test_who_is_no_proxy_of_ours_is_told_nothing_by(forged: list[str], peer: str) -> None:
    assert client_seen(behind(TRUSTED), peer, [", ".join(forged)]) == peer
    assert client_seen(behind(""), "127.0.0.1", [", ".join(forged)]) == "127.0.0.1"


@pytest.mark.parametrize("peer", ["127.0.0.1", "::1", "10.0.0.5", ""])
def test_nobody_is_a_proxy_who_was_not_named(peer: str) -> None:
    """The attack: somebody on the machine, or at the end of a tunnel to it, picks the address that limits count."""
    assert Settings(api=ApiSettings()).api.proxies == []
    assert client_seen(Settings(api=ApiSettings()), peer, ["7.7.7.7"]) == peer


def test_the_environment_of_uvicorn_does_not_undo_it(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = behind(TRUSTED)
    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")
    assert client_seen(settings, "203.0.113.9", ["6.6.6.6"]) == "203.0.113.9"
    with refused_as("unknown_setting", match=r"FORWARDED_ALLOW_IPS.*STONE_API__TRUSTED"):
        Settings()
