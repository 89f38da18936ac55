"""Settings with which nobody could sign in, or anybody, end a process as it starts."""

import re
import shlex
from pathlib import Path
from typing import Any

import pytest
from pydantic import SecretStr

from services.runtime.oidc.settings import OidcSettings
from services.runtime.oidc.settings_checks import groups_in
from services.runtime.settings import ApiSettings, Settings
from services.runtime.settings_checks import ImpossibleSettingsError

LAB = {"issuer": "https://id.lab.example/realms/lab", "client_id": "stone"}


def made(is_by_password: bool = True, **oidc: Any) -> Settings:
    return Settings(api=ApiSettings(passwords=is_by_password), oidc=OidcSettings(**oidc))


@pytest.mark.parametrize(
    ("oidc", "words"),
    [
        ({}, "ISSUER is not set: then nobody could sign in"),
        (LAB, "names no group: then nobody could administer"),
        (LAB | {"administrators": " , "}, "names no group: then nobody could administer"),
    ],
)
def test_passwords_are_not_switched_off_where_nobody_could_administer_then(oidc: dict[str, Any], words: str) -> None:
    with pytest.raises(ImpossibleSettingsError, match=words):
        made(is_by_password=False, **oidc)


def test_passwords_are_switched_off_where_a_group_administers() -> None:
    assert not made(is_by_password=False, **LAB, administrators="stone-admins").api.passwords


@pytest.mark.parametrize(
    "issuer",
    [
        "http://id.lab.example",
        "id.lab.example",
        "https://",
        "https://ada:secret@id.lab.example",
        "https://id.lab.example/?realm=lab",
        "https://id.lab.example/#lab",
        "https://id.lab.example/a b",
        "https://id.lab.example:port",
        "file:///etc/passwd",
        "https://id.lab.example/" + "a" * 500,
    ],
)
def test_an_issuer_that_is_no_safe_address_is_refused(issuer: str) -> None:
    with pytest.raises(ImpossibleSettingsError, match="STONE_OIDC__ISSUER is"):
        made(issuer=issuer, client_id="stone")


@pytest.mark.parametrize(
    "issuer", ["https://id.lab.example/", "http://127.0.0.1:9400", "http://localhost:8081/realms/x"]
)
def test_an_issuer_is_https_or_on_this_machine(issuer: str) -> None:
    assert made(issuer=issuer, client_id="stone").oidc.issuer == issuer


@pytest.mark.parametrize(
    ("oidc", "words"),
    [
        ({"issuer": LAB["issuer"]}, "needs STONE_OIDC__CLIENT_ID"),
        ({"client_id": "stone"}, "there is no provider"),
        ({"client_secret": SecretStr("hidden")}, "there is no provider"),
        (LAB | {"scopes": "profile email"}, "must hold openid"),
        (LAB | {"timeout_s": 0.0}, "STONE_OIDC__TIMEOUT_S is 0 and must be more than 0"),
    ],
)
def test_half_a_provider_is_refused(oidc: dict[str, Any], words: str) -> None:
    with pytest.raises(ImpossibleSettingsError, match=words) as refusal:
        made(**oidc)
    assert "hidden" not in str(refusal.value)


def test_a_provider_without_a_title_is_called_by_its_host() -> None:
    assert made(**LAB).oidc.shown_title == "id.lab.example"
    assert made(**LAB, title="Field Robotics Lab").oidc.shown_title == "Field Robotics Lab"


def test_the_example_of_the_administrators_guide_is_a_provider(monkeypatch: pytest.MonkeyPatch) -> None:
    guide = (Path(__file__).resolve().parents[4] / "docs" / "administrator.md").read_text("utf-8")
    (block,) = re.findall(r"```sh\n# lab\.env[^\n]*\n(.*?)```", guide, re.DOTALL)
    for line in shlex.split(block):
        monkeypatch.setenv(*line.split("=", 1))
    settings = Settings()
    assert settings.oidc.shown_title == "Field Robotics Lab"
    assert groups_in(settings.oidc.participants) == {"students", "guests"}
