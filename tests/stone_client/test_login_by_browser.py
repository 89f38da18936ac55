"""`stone auth login` with a browser's help: the real command against a real server, approved by a person meanwhile."""

import json
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from services.runtime.platform import Platform
from stone_client.browser_sign_in import asks_for_browser
from testing.api.lab import Lab, served_lab
from testing.api.serving import Person, in_browser, person
from testing.servers.oidc import OidcServer
from testing.stone_serve import STONE, environment
from tests.stone_client.participating import stone


@pytest.fixture
def ada(platform: Platform) -> Person:
    return person(platform, "curator", "ada")


@pytest.fixture
def local(platform: Platform) -> Iterator[Lab]:
    """A platform without a provider."""
    with served_lab(platform, platform.settings.oidc) as made:
        yield made


@contextmanager
def login(tmp_path: Path, url: str, *options: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command as it runs, and the code that it showed."""
    command = [*STONE, "auth", "login", url, *options, "--json"]
    pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(command, text=True, env=environment(tmp_path / "data"), **pipes)  # type: ignore[call-overload]
    try:
        assert process.stderr is not None
        opened, shown = process.stderr.readline(), process.stderr.readline()
        found = re.search(r"[B-Z]{4}-[B-Z]{4}", shown)
        assert found, opened + shown + process.stderr.read()
        assert opened.strip() == f"Open {url}/device?code={found[0]}"
        yield process, found[0]
    finally:
        process.kill()
        process.wait()


def decide(lab: Lab, who: Person, code: str, approves: bool) -> None:
    body, headers = {"user_code": code, "approves": approves}, in_browser(lab.platform, who)
    httpx.post(f"{lab.url}/api/v1/device-grants/decision", json=body, headers=headers).raise_for_status()


def test_the_command_waits_for_the_approval_and_keeps_the_token(local: Lab, ada: Person, tmp_path: Path) -> None:
    with login(tmp_path, local.url, "--browser") as (process, code):
        decide(local, ada, code, approves=True)
        said, _ = process.communicate(timeout=300)
    assert process.returncode == 0
    assert json.loads(said) == {
        "url": local.url,
        "name": "ada",
        "role": "curator",
        "scopes": ["read", "submit", "upload"],
    }
    kept = json.loads((tmp_path / "configuration" / "credentials.json").read_text())
    secret = kept["servers"][local.url]["token"]
    me = httpx.get(f"{local.url}/api/v1/me", headers={"Authorization": f"Bearer {secret}"}).json()
    assert me["name"] == "ada"


def test_where_people_have_a_provider_the_command_asks_for_no_password(
    platform: Platform, oidc_server: OidcServer, ada: Person, tmp_path: Path
) -> None:
    with served_lab(platform, oidc_server.settings()) as lab:
        assert asks_for_browser(lab.url)
        with login(tmp_path, lab.url) as (process, code):
            decide(lab, ada, code, approves=True)
            process.communicate(timeout=300)
        assert process.returncode == 0


@pytest.mark.parametrize("other", [["--name", "ada"], ["--password-stdin"], ["--token-stdin"]])
def test_a_browser_says_who_one_is_and_nothing_else(other: list[str]) -> None:
    ended = stone("auth", "login", "http://127.0.0.1:1", "--browser", *other)
    assert ended.exit_code == 2
    assert "--browser" in ended.stderr
