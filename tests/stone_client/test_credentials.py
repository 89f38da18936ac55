"""Which server is meant and with which token: what was typed, then the environment, then what is remembered."""

import json
import stat
from pathlib import Path

import pytest

from stone_client.credentials import (
    Server,
    choose_server,
    configuration_folder,
    is_local,
    plain_url,
    read_credentials,
    remember,
)
from stone_client.errors import BadCredentialsFileError, BadUrlError, NoServerError, NotSignedInError

HOME = "http://127.0.0.1:8080"
AWAY = "https://stone.example"


@pytest.fixture(autouse=True)
def nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STONE_URL", "STONE_TOKEN", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))


def test_without_any_server_the_refusal_says_how_to_name_one() -> None:
    with pytest.raises(NoServerError, match="stone login URL"):
        choose_server()


def test_a_server_without_a_token_is_refused_by_name() -> None:
    with pytest.raises(NotSignedInError, match=f"stone login {AWAY}"):
        choose_server(AWAY)


@pytest.mark.parametrize("content", ["{", "[]", '{"servers": {"x": 1}}', '{"servers": []}'])
def test_a_file_changed_by_hand_is_refused_not_overwritten(content: str) -> None:
    path = configuration_folder() / "credentials.json"
    path.parent.mkdir(parents=True)
    path.write_text(content)
    with pytest.raises(BadCredentialsFileError, match=r"credentials\.json"):
        remember(HOME, "stone_1", as_default=True)
    assert path.read_text() == content


@pytest.mark.parametrize("url", ["ftp://stone.example", "http://", "http://a:b@c", "http://host:port", "http://h/path"])
def test_what_is_no_servers_address_is_refused(url: str) -> None:
    with pytest.raises(BadUrlError):
        plain_url(url)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("127.0.0.1:8080", HOME),
        ("https://stone.example/", AWAY),
        ("HTTPS://Stone.Example", AWAY),
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
    remember(AWAY, "stone_away", as_default=False)
    assert choose_server() == Server(HOME, "stone_home")
    assert choose_server(AWAY) == Server(AWAY, "stone_away")
    monkeypatch.setenv("STONE_URL", AWAY)
    assert choose_server() == Server(AWAY, "stone_away")
    assert choose_server(HOME) == Server(HOME, "stone_home")
    monkeypatch.setenv("STONE_TOKEN", "stone_given")
    assert choose_server() == Server(AWAY, "stone_given")


def test_a_second_server_does_not_become_the_default_by_itself() -> None:
    remember(AWAY, "stone_away", as_default=True)
    remember(HOME, "stone_home", as_default=False)
    assert read_credentials().default == AWAY


def test_a_token_is_not_shown_by_accident() -> None:
    assert "stone_secret" not in repr(Server(HOME, "stone_secret"))


@pytest.mark.parametrize(("url", "is_ours"), [(HOME, True), ("http://localhost:1", True), (AWAY, False)])
def test_a_server_on_this_machine_is_told_from_others(url: str, is_ours: bool) -> None:
    assert is_local(url) is is_ours
