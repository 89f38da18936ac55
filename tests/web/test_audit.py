"""The audit log in a browser: verified, filtered, each line's facts unfolded."""

from playwright.sync_api import expect
from sqlalchemy import update

from services.runtime.orm import AuditEntry
from services.runtime.platform import Platform
from testing.api.serving import Person, client_of
from testing.web.browsing import Site
from tests.api.test_audit import unguarded
from tests.web.looking import look


def acts(platform: Platform, administrator: Person) -> None:
    """Three users come, one is changed."""
    with client_of(platform, administrator) as api:
        for name in ("ada", "ben", "cleo"):
            body = {"name": name, "role": "curator", "reason": f"{name} joins the field team"}
            made = api.post("/api/v1/users", json=body).json()
        change = {"role": "participant", "reason": "plans to submit only"}
        assert api.patch(f"/api/v1/users/{made['id']}", json=change).status_code == 200


def test_the_log_is_verified_filtered_and_unfolded(site: Site, administrator: Person) -> None:
    acts(site.platform, administrator)
    with site.visit(administrator) as page:
        page.goto("/admin/audit")
        expect(page.get_by_text("The log is intact")).to_be_visible()
        expect(page.get_by_text("4 lines verified.")).to_be_visible()
        lines = page.locator(".audit-line")
        expect(lines).to_have_count(4)
        lines.first.locator("summary").press("Enter")
        expect(lines.first.locator(".facts")).to_contain_text("participant")
        look(page, "audit")
        page.get_by_label("Action").select_option("user.add")
        page.get_by_role("button", name="Filter", exact=True).click()
        expect(lines).to_have_count(3)
        page.goto("/admin/audit?actor=nobody")
        expect(page.get_by_role("heading", name="No matching entries")).to_be_visible()
        look(page, "audit-none")


def test_a_line_that_somebody_changed_is_found(site: Site, administrator: Person) -> None:
    acts(site.platform, administrator)
    with site.platform.database.transaction() as session:
        unguarded(session)
        session.execute(update(AuditEntry).where(AuditEntry.number == 2).values(reason="nothing to see"))
    with site.visit(administrator) as page:
        page.goto("/admin/audit")
        expect(page.get_by_text("The log is broken at line 2")).to_be_visible()
        look(page, "audit-broken")


def test_a_log_longer_than_a_page_goes_on(site: Site, administrator: Person) -> None:
    with client_of(site.platform, administrator) as api:
        for number in range(51):
            body = {"name": f"u{number}", "role": "participant", "reason": "workshop"}
            assert api.post("/api/v1/users", json=body).status_code == 201
    with site.visit(administrator) as page:
        page.goto("/admin/audit?act=user.add")
        expect(page.locator(".audit-line")).to_have_count(50)
        page.get_by_role("link", name="Older").click()
        expect(page.locator(".audit-line")).to_have_count(1)
