"""Clients of other releases are understood or told what to install; who says no release is answered as ever."""

from hashlib import sha256
from pathlib import Path

import httpx
import pytest

from api.client_wheel import FILENAME, OLDEST_CLIENT, ClientWheel, client_wheel, install_line
from api.main import make_api
from services.runtime.code_version import RELEASE
from services.runtime.platform import Platform
from stone_base.releases import HEADER, is_older
from stone_client.release import OLDEST_SERVER, own_release
from testing.api.serving import Person, serving


def test_a_client_that_says_no_release_is_understood_and_told_none(api: httpx.Client, participant: Person) -> None:
    """As the release did that came before the header."""
    headers = {**participant.headers, "User-Agent": "stone-client/0.1"}
    answer = api.get("/api/v1/me", headers=headers)
    assert answer.status_code == 200
    assert HEADER not in answer.headers


@pytest.mark.parametrize("release", [OLDEST_CLIENT, RELEASE, "999.0.0", "banana", "9" * 4000])
def test_a_client_that_is_new_enough_or_says_nothing_readable_is_answered_with_ours(
    api: httpx.Client, participant: Person, release: str
) -> None:
    answer = api.get("/api/v1/me", headers={**participant.headers, HEADER: release})
    assert answer.status_code == 200
    assert answer.headers[HEADER] == RELEASE


def test_a_client_that_is_too_old_is_told_the_line_that_installs_the_one_that_fits(
    platform: Platform, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / FILENAME).write_bytes(b"a wheel")
    monkeypatch.setattr("api.main.client_wheel", lambda: client_wheel(tmp_path))
    with serving(platform, make_api(platform)) as url:
        answer = httpx.get(f"{url}/api/v1/me", headers={HEADER: "0.0.9"})
    problem = answer.json()
    assert (answer.status_code, problem["code"]) == (426, "client_too_old")
    assert answer.headers["Upgrade"] == f"stone-client/{OLDEST_CLIENT}"
    assert "release 0.0.9" in problem["detail"]
    assert f"pip install {platform.settings.api.url}/downloads/{FILENAME}" in problem["detail"]


def test_what_is_offered_is_said_with_size_and_hash(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    wheel = ClientWheel(FILENAME, b"a wheel")
    monkeypatch.setattr("api.main.client_wheel", lambda: wheel)
    with serving(platform, make_api(platform)) as url:
        record = httpx.get(f"{url}/api/v1/client").json()
    assert (record["release"], record["oldest_client"]) == (RELEASE, OLDEST_CLIENT)
    assert record["wheel"] == {
        "filename": FILENAME,
        "path": f"/downloads/{FILENAME}",
        "size_bytes": 7,
        "sha256": sha256(b"a wheel").hexdigest(),
    }


def test_only_the_wheel_of_this_very_release_is_offered(tmp_path: Path) -> None:
    (tmp_path / "stone_client-0.0.1-py3-none-any.whl").write_bytes(b"an old one")
    assert client_wheel(tmp_path) is None
    assert client_wheel(tmp_path / "absent") is None
    assert install_line("http://server/", None) == "see http://server/downloads/"


def test_client_and_server_of_one_release_understand_each_other() -> None:
    assert own_release() == RELEASE
    assert not is_older(own_release(), OLDEST_CLIENT)
    assert not is_older(RELEASE, OLDEST_SERVER)
