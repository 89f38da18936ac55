"""Entries of the audit log as sentences that name the thing."""

import re
from pathlib import Path

import httpx
from playwright.sync_api import expect

from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds import made
from tests.web.looking import look
from web.audit_words import VERBS

ROOT = Path(__file__).resolve().parents[2]
RECORDED = re.compile(r'(?:audit\.record|record_admin_act)\(\s*session,\s*caller,\s*"([a-z_]+\.[a-z_]+)"')


def test_every_act_that_a_route_records_has_a_verb() -> None:
    recorded = {act for path in (ROOT / "api").rglob("*.py") for act in RECORDED.findall(path.read_text("utf-8"))}
    assert len(recorded) > 20
    assert recorded <= set(VERBS)


def test_an_entry_is_a_sentence_with_the_thing_and_leads_to_it(
    site: Site, administrator: Person, curator: Person
) -> None:
    with httpx.Client(base_url=site.url) as api:
        sequence = made.sequence(api, curator)
        url = f"/api/v1/sequences/{sequence['id']}"
        found = api.get(url, headers=curator.headers)
        body, match = {"region": "Alps"}, {"If-Match": found.headers["etag"]}
        assert api.patch(url, json=body, headers=curator.headers | match).is_success
        added = {"name": "grace", "role": "curator", "reason": "field trial"}
        assert api.post("/api/v1/admin/users", json=added, headers=administrator.headers).is_success
    with site.visit(administrator) as page:
        page.goto("/admin/audit")
        lines = page.get_by_role("region", name="Lines, newest first").get_by_role("listitem")
        expect(lines.filter(has_text="added the user grace")).to_contain_text("field trial")
        changed = lines.filter(has_text=f"changed the sequence {sequence['name']}")
        changed.locator("summary").click()
        look(page, "audit-sentences")
        changed.get_by_role("link", name=sequence["name"]).click()
        expect(page).to_have_url(f"{site.url}/sequences/{sequence['id']}")
