"""The administrator's list of jobs: days, orders, outcomes; and the durations by kind over days."""

import re

import pytest
from playwright.sync_api import expect
from sqlalchemy import select

from benchmarks.dashboard.rows import fill
from services.runtime.orm import Job
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.web.reading import Reading
from testing.worlds.made import job
from tests.web.looking import look
from web.pages.admin.durations import durations_of

SECOND = 10**9
HOUR = 3600 * SECOND
DAY = 24 * HOUR
NOON = 1_779_969_600 * SECOND
"""2026-05-28 12:00 UTC."""
ROW = re.compile(r'<tr id="job-([0-9a-f]{32})"')


def placed(platform: Platform, owner: Person, created_ns: int, lasted_s: int | None) -> str:
    job_id = job(platform, owner, "ingest.speak")
    with platform.database.transaction() as session:
        row = session.get_one(Job, job_id)
        row.created_ns = created_ns
        if lasted_s is not None:
            row.state, row.started_ns = "succeeded", created_ns
            row.finished_ns = created_ns + lasted_s * SECOND
    return job_id


def test_jobs_are_listed_by_day_and_by_duration(
    reading: Reading, platform: Platform, administrator: Person, curator: Person
) -> None:
    late_yesterday = placed(platform, curator, NOON - 12 * HOUR - SECOND, 5)
    early, late = placed(platform, curator, NOON - 12 * HOUR, 900), placed(platform, curator, NOON + 11 * HOUR, 30)
    tomorrow = placed(platform, curator, NOON + 12 * HOUR, None)

    def listed(query: str) -> list[str]:
        return ROW.findall(reading.html(f"/admin/jobs?{query}", administrator))

    assert listed("since=2026-05-28&until=2026-05-28") == [late, early]
    assert listed("since=2026-05-28&until=2026-05-28&order=oldest") == [early, late]
    assert listed("since=2026-05-28") == [tomorrow, late, early]
    assert listed("until=2026-05-27") == [late_yesterday]
    assert listed("order=longest") == [early, late, late_yesterday]
    assert listed("until=2026-05-27&list=queued") == []
    html = reading.html("/admin/jobs", administrator)
    assert "2026-05-28 23:00:00 UTC" in html, "to the second"


@pytest.mark.parametrize("day", ["2026-13-01", "yesterday", "2026-05-28x", "99999-01-01"])
def test_a_day_that_is_none_is_refused(reading: Reading, administrator: Person, day: str) -> None:
    assert reading.status(f"/admin/jobs?since={day}", administrator) == 422
    assert reading.status("/admin/jobs?since=2026-02-31&until=", administrator) == 200


def test_durations_are_told_apart_by_kind_and_day() -> None:
    jobs = [("map", "succeeded", 0, took * SECOND) for took in (1, 2, 9)]
    jobs += [("map", "succeeded", DAY, DAY + 30 * SECOND), ("map", "failed", 0, 500 * SECOND)]
    jobs += [("fuse", "failed", 0, SECOND)]
    of_map, of_fuse = durations_of(jobs)
    assert (of_map.kind, of_map.ended, of_map.failed) == ("map", 5, 1)
    assert (of_map.median_s, of_map.longest_s) == (5.5, 30.0), "the failed one does not count"
    assert of_map.daily == (("1970-01-01", 2.0, 3), ("1970-01-02", 30.0, 1))
    assert (of_fuse.ended, of_fuse.failed, of_fuse.median_s, of_fuse.daily) == (1, 1, None, ())


def test_the_durations_and_the_filters_are_looked_at(site: Site, platform: Platform, administrator: Person) -> None:
    with platform.database.transaction() as session:
        fill(session, runs=120, workers=20)
        newest = session.scalars(select(Job.kind).where(Job.finished_ns.is_not(None)).limit(1)).one()
    with site.visit(administrator) as page:
        page.goto("/admin/durations?days=90")
        expect(page.get_by_role("region", name="Durations by kind")).to_contain_text(newest)
        look(page, "admin-durations")
        page.goto("/admin/jobs")
        page.get_by_label("Order").select_option("longest")
        page.get_by_role("button", name="Filter").click()
        expect(page.get_by_role("region", name="Jobs, longest first")).to_be_visible()
        look(page, "admin-jobs-longest")
