"""Pages about codes: a visitor finds what a code means, whether it harms labels and what to do."""

import httpx
from playwright.sync_api import expect

from services.runtime.platform import Platform
from stone_base.codes.catalogue import CATALOGUE
from stone_base.codes.meaning import HARM_WORDS
from testing.api.serving import serving
from testing.web.browsing import Site
from tests.web.looking import look
from web.main import make_site


def test_a_visitor_comes_from_any_page_to_what_a_code_means(site: Site) -> None:
    with site.visit() as page:
        page.goto("/benchmarks")
        page.get_by_role("contentinfo").get_by_role("link", name="Codes").click()
        expect(page.get_by_role("listitem").filter(has=page.get_by_role("link", name="TIM-201"))).to_contain_text(
            "labels unaffected"
        )
        look(page, "codes")
        page.get_by_role("link", name="LAB-603").click()
        main = page.get_by_role("main")
        expect(page.get_by_role("heading", level=1)).to_have_text("LAB-603")
        expect(main).to_contain_text("labels may be wrong")
        expect(page.get_by_role("region", name="On the platform")).to_have_text(
            "stone process SEQUENCE --profile local"
        )
        look(page, "code")
        main.get_by_role("link", name="All codes").click()
        expect(page).to_have_url(f"{site.url}/codes")


def test_every_code_has_a_page_with_its_meaning_its_harm_and_its_remedy(platform: Platform) -> None:
    with serving(platform, make_site(platform)) as url, httpx.Client(base_url=url, timeout=300.0) as client:
        for code, one in CATALOGUE.items():
            answer = client.get(f"/codes/{code}", headers={"Accept": "text/html"})
            assert answer.status_code == 200, code
            text = answer.text.replace("&#39;", "'").replace("&gt;", ">")
            assert one.meaning in text
            assert one.remedy in text
            assert HARM_WORDS[one.harm] in text
