"""The first ten minutes on an empty platform: each role's first steps, help, and where the password and docs are."""

import re
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Page, expect

from services.runtime.embedded.first_start import ensure_keys
from services.runtime.orm import SequenceRow, SubmissionRow, Team, TeamMember
from testing.api.serving import Person, person
from testing.web.browsing import Site
from testing.worlds.benchmark_world import benchmark_world
from tests.web.looking import look
from tests.web.test_pages_access import cookie
from web.pages import docs

FIRST = {"participant": "Choose a benchmark", "curator": "Upload a recording", "administrator": "Add users"}


def next_step(page: Page) -> str:
    return page.locator(".first-steps [data-is-next] h3").inner_text()


def manual(folder: Path) -> Path:
    """A small manual, as MkDocs writes one: a page with an inline script, a style sheet, a worker, a folder."""
    (folder / "reference").mkdir(parents=True)
    (folder / "index.html").write_text(
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Docs</title>'
        '<link rel="icon" href="data:,"><link rel="stylesheet" href="site.css">'
        "<script>document.documentElement.dataset.ran = 'yes'</script></head>"
        '<body><h1>The manual</h1><p style="color: green">Styled</p><script src="main.js"></script></body></html>'
    )
    (folder / "site.css").write_text("h1 { color: rgb(1, 2, 3); }")
    (folder / "main.js").write_text("new Worker('search.js').onmessage = m => document.body.dataset.found = m.data;")
    (folder / "search.js").write_text("postMessage('worker');")
    (folder / "reference" / "index.html").write_text("<!doctype html><title>Reference</title>")
    return folder


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    made = manual(tmp_path / "manual")
    monkeypatch.setattr(docs, "MANUAL", made)
    return made


def test_from_an_empty_platform_to_the_first_step_help_and_the_manual(site: Site, built: Path) -> None:
    """The journey: the sign-in page names the file, the file lets one in, home says what is first."""
    secret = ensure_keys(site.platform).password
    with site.visit() as page:
        page.goto("/")
        page.get_by_role("main").get_by_role("link", name="Sign in").click()
        file = page.locator("code", has_text="admin-password")
        expect(file).to_be_visible()
        look(page, "sign-in-first")
        password = Path(file.inner_text()).read_text().strip()
        assert password == secret
        page.get_by_label("Name").fill("admin")
        page.get_by_label("Password").fill(password)
        page.keyboard.press("Enter")
        expect(page.get_by_role("heading", name="First steps")).to_be_visible()
        assert next_step(page) == "Add users"
        page.get_by_role("banner").get_by_role("link", name="Help").click()
        expect(page.get_by_role("heading", name="Keyboard")).to_be_visible()
        look(page, "help")
        page.get_by_role("banner").get_by_role("link", name="Docs").click()
        expect(page.get_by_role("heading", name="The manual")).to_be_visible()


@pytest.mark.parametrize("role", FIRST)
def test_an_empty_platform_tells_each_role_its_first_step_and_shows_it_only_what_it_may(role: str, site: Site) -> None:
    somebody = person(site.platform, role)
    with site.visit(somebody) as page:
        page.goto("/")
        assert next_step(page) == FIRST[role]
        look(page, f"home-empty-{role}")
        paths = [link.get_attribute("href") or "" for link in page.locator(".first-steps a").all()]
    with httpx.Client(base_url=site.url, headers=cookie(site.platform, somebody)) as client:
        assert {path: client.get(path, headers={"Accept": "text/html"}).status_code for path in paths} == dict.fromkeys(
            paths, 200
        )


def done(site: Site, who: Person) -> list[str]:
    """The titles of the steps that Help marks as done."""
    text = httpx.get(f"{site.url}/help", headers=cookie(site.platform, who), timeout=300).text
    return re.findall(r"<h3>([^<]+) <span class=\"state\"", text)


def test_a_participants_steps_are_done_by_their_own_team_and_submission(site: Site, participant: Person) -> None:
    person(site.platform, "participant", "other")
    assert done(site, participant) == []
    with site.platform.database.transaction() as session:
        team = Team(name="Terrain Gang")
        session.add(team)
        session.flush()
        session.add(TeamMember(team_id=team.id, user_id=participant.user_id))
    assert done(site, participant) == ["Choose a benchmark", "Create or join a team"]


def test_a_curators_second_step_leads_to_their_own_sequence(site: Site, curator: Person) -> None:
    with site.platform.database.transaction() as session:
        made = SequenceRow(owner_id=curator.user_id, name="forest")
        session.add(made)
        session.flush()
        sequence_id = made.id
    text = httpx.get(site.url, headers=cookie(site.platform, curator), timeout=300).text
    assert f'<a href="/sequences/{sequence_id}">Assign a calibration</a>' in text


def test_where_all_is_done_home_says_nothing_of_first_steps(site: Site) -> None:
    world = benchmark_world(site.platform)
    with site.platform.database.transaction() as session:
        entered = {"phase_id": world.phase("val"), "team_id": world.teams[0], "user_id": world.captains[0].user_id}
        kept = {"method": "GroundNet", "modality": "L", "declared_sha256": "0" * 64, "size_bytes": 1}
        session.add(SubmissionRow(**entered, **kept))
    with httpx.Client(base_url=site.url, timeout=300) as client:
        scored = client.get("/", headers=cookie(site.platform, world.captains[0])).text
        new = client.get("/", headers=cookie(site.platform, person(site.platform, "participant"))).text
    assert ("First steps" in scored, "First steps" in new) == (False, True)


def test_the_manual_runs_under_its_own_policy(site: Site, built: Path) -> None:
    with site.visit() as page:
        page.goto("/docs")
        expect(page).to_have_url(f"{site.url}/docs/")
        expect(page.locator("html")).to_have_attribute("data-ran", "yes")
        expect(page.locator("body")).to_have_attribute("data-found", "worker")
        expect(page.get_by_role("heading", name="The manual")).to_have_css("color", "rgb(1, 2, 3)")


def test_a_folder_of_the_manual_is_its_index_and_what_did_not_change_is_not_sent_again(site: Site, built: Path) -> None:
    with httpx.Client(base_url=site.url) as client:
        assert "Reference" in client.get("/docs/reference/").text
        sheet = client.get("/docs/site.css")
        assert sheet.headers["content-type"].startswith("text/css")
        assert client.get("/docs/site.css", headers={"If-None-Match": sheet.headers["etag"]}).status_code == 304


@pytest.mark.parametrize(
    "path", ["..%2fsecret", "%2e%2e/secret", "/etc/passwd", "%00", "link", "reference%2f..%2f..%2fsecret", "a" * 3000]
)
def test_nothing_outside_the_manual_is_sent(path: str, site: Site, built: Path) -> None:
    (built.parent / "secret").write_text("nobody's")
    (built / "link").symlink_to(built.parent / "secret")
    answer = httpx.get(f"{site.url}/docs/{path}", headers={"Accept": "text/html"})
    assert answer.status_code in (401, 404)  # a visitor is asked to sign in
    assert "nobody's" not in answer.text


def test_without_a_manual_docs_say_how_to_build_it(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs, "MANUAL", tmp_path / "none")
    with site.visit() as page:
        page.goto("/docs/participant.html")
        expect(page.get_by_text("make docs")).to_be_visible()
        look(page, "docs-missing")
