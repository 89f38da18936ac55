"""What browsers load: once, compressed, from here alone; and nothing of a page runs that is not ours."""

import base64
import hashlib
import json
import re

import httpx
import pytest
from playwright.sync_api import expect

from services.runtime.platform import Platform
from testing.api.serving import Person, serving
from testing.web.browsing import Site
from web.assets import BUNDLED, LIBRARIES, built_assets
from web.errors import PagesNotBuiltError
from web.main import make_site


def test_every_asset_of_a_page_is_there_for_ever_and_compressed(platform: Platform) -> None:
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url) as client:
        html = client.get("/sign-in", headers={"Accept": "text/html"}).text
        paths = re.findall(r'(?:src|href)="(/assets/[^"]+)"', html)
        assert len(paths) >= 4
        for path in paths:
            answer = client.get(path, headers={"Accept-Encoding": "gzip"})
            assert (answer.status_code, answer.headers["content-encoding"]) == (200, "gzip")
            assert "immutable" in answer.headers["cache-control"]
            assert client.get(path, headers={"Accept-Encoding": "identity"}).content == answer.content
        other = re.sub(r"/assets/[0-9a-f]+/", "/assets/0000000000000000/", paths[0])
        assert client.get(other).status_code == 404


@pytest.mark.parametrize(
    "path", ["../main.py", "..%2fmain.py", "libraries/../../main.py", "libraries/three/package.json"]
)
def test_nothing_else_of_the_folder_is_served(platform: Platform, path: str) -> None:
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url) as client:
        assert client.get(f"/assets/{built_assets().digest}/{path}").status_code == 404


def test_the_import_map_names_our_copies_and_the_policy_lets_only_it_through(platform: Platform) -> None:
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url) as client:
        answer = client.get("/sign-in", headers={"Accept": "text/html"})
    (text,) = re.findall(r'<script type="importmap">(.*?)</script>', answer.text)
    imports = json.loads(text)["imports"]
    assert set(imports) == {*LIBRARIES, *BUNDLED}
    assert all(path.startswith("/assets/") for path in imports.values())
    policy = answer.headers["content-security-policy"]
    assert f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" in policy
    assert "unsafe" not in policy


def test_pages_that_were_not_built_say_how_to_build_them(monkeypatch: pytest.MonkeyPatch, tmp_path: object) -> None:
    monkeypatch.setattr("web.assets.BUILT", tmp_path)
    with pytest.raises(PagesNotBuiltError, match="make install"):
        built_assets()


def test_script_in_a_name_is_text_and_script_that_was_put_in_does_not_run(site: Site, curator: Person) -> None:
    with site.visit(curator, expected=["Content Security Policy"]) as page:
        page.goto("/account")
        page.evaluate(
            """() => { const one = document.createElement('script'); one.textContent = 'window.ran = true';
                       document.body.append(one); document.body.setAttribute('onclick', 'window.ran = true'); }"""
        )
        page.click("body")
        assert page.evaluate("window.ran") is None


def test_times_are_in_the_readers_zone_and_the_theme_is_remembered(site: Site, curator: Person) -> None:
    with site.visit(curator, timezone_id="Asia/Seoul") as page:
        page.goto("/account")
        assert "stone_zone=Asia/Seoul" in page.evaluate("document.cookie")
        page.get_by_role("button", name="Light or dark").click()
        chosen = page.locator("html").get_attribute("data-theme")
        page.reload()
        expect(page.locator("html")).to_have_attribute("data-theme", chosen or "")
