"""The dates of a phase at a browser: chosen in a time zone, kept in UTC, and not touched where nobody touched them."""

from datetime import UTC, datetime

import pytest
from playwright.sync_api import expect

from services.runtime.orm import Phase
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION
from testing.web.browsing import Site
from testing.worlds.benchmark_world import World, benchmark_world
from tests.web.looking import look

NAMED_FROM_NS = 4_102_444_800_123_456_000  # with microseconds, which no picker knows


@pytest.fixture
def world(platform: Platform) -> World:
    return benchmark_world(platform)


def nanoseconds(*moment: int) -> int:
    return int(datetime(*moment, tzinfo=UTC).timestamp()) * 10**9  # type: ignore[misc, arg-type]


def test_dates_are_chosen_in_a_time_zone_and_the_window_in_days(site: Site, world: World) -> None:
    with world.platform.database.transaction() as session:
        session.get_one(Phase, world.val).named_from_ns = NAMED_FROM_NS
    with site.visit(world.administrator, timezone_id="Asia/Seoul") as page:
        page.goto(f"/admin/benchmarks/{world.benchmark}/val")
        page.get_by_role("button", name="Edit rules").click()
        rules = page.get_by_role("dialog")
        zone = rules.get_by_label("Time zone")
        expect(zone).to_have_value("Asia/Seoul")
        expect(rules.get_by_label("Team names shown from")).to_have_value("2100-01-01T09:00")
        rules.get_by_label("Closes").fill("2199-10-01T09:00")
        expect(rules.get_by_text("2199-10-01 00:00 UTC")).to_be_visible()
        look(page, "admin-phase-dates")
        zone.select_option("Etc/GMT+12")
        expect(rules.get_by_label("Closes")).to_have_value("2199-09-30T12:00")
        zone.select_option("UTC")
        expect(rules.get_by_label("Closes")).to_have_value("2199-10-01T00:00")
        rules.get_by_label("Opens").fill("2026-01-02T03:04:05")
        rules.get_by_label("Window, days").fill("14")
        rules.get_by_label("Reason").fill("one month more")
        with page.expect_navigation():
            rules.get_by_role("button", name="Save").click()
        page.get_by_role("button", name="Edit rules").click()
        expect(rules.get_by_label("Window, days")).to_have_value("14")
    with world.platform.database.reading() as session:
        phase = session.get_one(Phase, world.val)
        assert phase.closes_ns == nanoseconds(2199, 10, 1)
        assert phase.opens_ns == nanoseconds(2026, 1, 2, 3, 4, 5)
        assert phase.named_from_ns == NAMED_FROM_NS
        assert phase.window_ns == 14 * 86400 * 10**9


def test_the_metric_of_a_re_score_is_chosen_from_those_that_score(site: Site, world: World) -> None:
    with site.visit(world.administrator) as page:
        page.goto(f"/admin/benchmarks/{world.benchmark}/val")
        page.get_by_role("button", name="Start re-score").click()
        metric = page.get_by_role("dialog").get_by_label("Metric")
        expect(metric).to_have_value(METRIC_VERSION)
        values = metric.locator("option").evaluate_all("all => all.map(one => one.value)")
        assert values == ["stone-iou-2", "stone-iou-occupied-2"]
        look(page, "admin-phase-metric")


@pytest.mark.parametrize(
    ("wall", "zone", "expected"),
    [
        ("2026-03-29T02:30", "Europe/Berlin", "2026-03-29T01:30:00.000Z"),  # left out in spring: 03:30
        ("2026-03-08T02:30", "America/New_York", "2026-03-08T07:30:00.000Z"),
        ("2026-10-25T03:30", "Europe/Berlin", "2026-10-25T02:30:00.000Z"),
        ("2026-07-01T12:00:07", "Europe/Berlin", "2026-07-01T10:00:07.000Z"),
        ("2026-01-01T00:00", "Etc/GMT+12", "2026-01-01T12:00:00.000Z"),
        ("2026-01-01T05:45", "Asia/Kathmandu", "2026-01-01T00:00:00.000Z"),
    ],
)
def test_a_clocks_hour_is_an_instant(site: Site, wall: str, zone: str, expected: str) -> None:
    with site.visit() as page:
        page.goto("/sign-in")
        said = page.evaluate(
            """async (given) => {
              const at = document.querySelector('script[src*="modules/app.js"]').src.replace("app.js", "moments.js");
              return new Date((await import(at)).instantOf(...given)).toISOString();
            }""",
            [wall, zone],
        )
    assert said == expected
