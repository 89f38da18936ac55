"""The administrator at the benchmarks: made, opened, re-scored with what that changes, alarms, grants, reports."""

import re

import pytest
from playwright.sync_api import Page, expect
from sqlalchemy import select

from services.domain.benchmarks.alarms.alarms import raise_alarms
from services.domain.benchmarks.phases.reported_results import reported_in
from services.runtime.orm import Activation, Alarm, Benchmark, Phase, Score, ScoringEntry, SubmissionRow, Team
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from tests.services.domain.benchmarks.scored import Place, another_truth, phase_of_rows, scored, scored_entry, team
from tests.web.looking import look

BEFORE = (0.52, 0.47, 0.44, 0.39, 0.31)
AFTER = (0.49, 0.51, 0.44, 0.36, 0.38)
TEAMS = ("Forest", "Lake", "Quarry", "Meadow", "Farm")


@pytest.fixture
def place(platform: Platform) -> Place:
    return phase_of_rows(platform)


def address(place: Place) -> str:
    with place.platform.database.reading() as session:
        phase = session.get_one(Phase, place.phase.id)
        return f"/admin/benchmarks/{session.get_one(Benchmark, phase.benchmark_id).name}/{phase.name}"


def give_reason(page: Page, words: str, button: str) -> None:
    asking = page.get_by_role("dialog")
    asking.get_by_label("Reason").fill(words)
    asking.get_by_role("button", name=button).click()


def entries_by_both_truths(place: Place) -> None:
    """Five entries with a score by the truth on the board and by another one, which turns their order."""
    truth_id = another_truth(place)
    for name, old, new in zip(TEAMS, BEFORE, AFTER, strict=True):
        submission_id = scored_entry(place, team(place, name), old, method=f"{name}Net")
        scored(place, submission_id, new, truth_id)


def test_a_re_score_is_started_read_as_a_difference_and_activated(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    entries_by_both_truths(place)
    with site.visit(administrator) as page:
        page.goto(address(place))
        look(page, "admin-phase")
        page.get_by_role("button", name="Start re-score").click()
        give_reason(page, "labels of the quarry corrected", "Start re-score")
        expect(page.get_by_role("heading", name="labels of the quarry corrected")).to_be_visible()
        expect(page.get_by_text("5 of 5")).to_be_visible()
        expect(page.get_by_role("img", name=re.compile("Ranks before and after"))).to_be_visible()
        expect(page.get_by_role("row", name=re.compile("LakeNet"))).to_contain_text("▲ 1")
        look(page, "admin-rescore")
        page.get_by_role("button", name="Activate").click()
        expect(page.get_by_role("dialog")).to_contain_text("with a new leader")
        give_reason(page, "as announced", "Activate now")
        expect(page.locator("#rescore")).to_contain_text("activated")
        expect(page.get_by_role("button", name="Abandon")).to_have_count(0)
    with platform.database.reading() as session:
        assert session.query(Activation).filter_by(phase_id=place.phase.id).count() == 2


def test_an_alarm_is_dismissed_and_a_team_granted_scorings(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    first, second = (scored_entry(place, team(place, name), 0.4, method=f"{name}Net") for name in TEAMS[:2])
    with platform.database.transaction() as session:
        scores = {row.submission_id: row for row in session.scalars(select(Score))}
        scores[second].content_sha256 = scores[first].content_sha256
        raise_alarms(session, scores[second])
        lake = session.get_one(SubmissionRow, second).team_id
        session.add(ScoringEntry(phase_id=place.phase.id, team_id=lake, amount=0, reason="granted"))
    with site.visit(administrator) as page:
        page.goto(address(place))
        alarms = page.get_by_role("region", name="Alarms")
        expect(alarms).to_contain_text("equal content")
        alarms.get_by_role("button", name="Dismiss").click()
        give_reason(page, "both wrapped the same baseline", "Dismiss")
        expect(alarms).to_contain_text("No open alarms")
        page.get_by_role("row", name=re.compile("Lake")).get_by_role("button", name="Grant").click()
        page.get_by_label("Additional submissions").fill("3")
        give_reason(page, "the platform was away", "Grant")
        expect(page.get_by_role("dialog")).to_have_count(0)
        expect(page.get_by_role("heading", name="Teams and quotas")).to_be_visible()
        page.wait_for_load_state()
    with platform.database.reading() as session:
        assert session.scalars(select(Alarm)).one().dismissed_ns is not None
        amounts = session.scalars(select(ScoringEntry.amount).where(ScoringEntry.team_id == lake))
        assert sorted(amounts) == [-3, 0]
        assert session.get_one(Team, lake).name == "Lake"


def test_where_no_alarm_is_open_the_page_does_not_claim_that_nothing_is_equal(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    """Where the ground truth is open, an entry that equals a baseline raises no alarm."""
    baseline = scored_entry(place, team(place, "Organisers"), 0.4, kind="baseline")
    copied = scored_entry(place, team(place, "Forest"), 0.4)
    with platform.database.transaction() as session:
        scores = {row.submission_id: row for row in session.scalars(select(Score))}
        scores[copied].content_sha256 = scores[baseline].content_sha256
        raise_alarms(session, scores[copied])
    with site.visit(administrator) as page:
        page.goto(address(place))
        alarms = page.get_by_role("region", name="Alarms")
        expect(alarms).to_contain_text("No open alarms")
        expect(alarms).to_contain_text("baselines are not compared where the ground truth is open")
        expect(alarms).not_to_contain_text("no equal")


def test_reported_rows_are_edited_and_put_back_at_once(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    with site.visit(administrator, expected=["422"]) as page:
        page.goto(address(place))
        editor = page.get_by_role("region", name="Reported results")
        for number in range(2):
            editor.get_by_role("button", name="Add a row").click()
            row = editor.get_by_role("row").nth(number + 1)
            row.get_by_label("Method").fill(f"Paper {number}")
            row.get_by_label("Modality").select_option("C+L")
            row.get_by_label("Source").fill("authors, year, table 2")
            row.get_by_label("Note").fill("of another split")
            row.get_by_label("miou").fill("0.342")
            row.get_by_label("Decimals (per cent)").fill("1")
        editor.get_by_label("Reason").fill("what the papers report")
        row.get_by_label("Source").fill("a\u200bb")
        editor.get_by_role("button", name="Save").click()
        expect(editor.get_by_role("alert")).to_contain_text("source")
        row.get_by_role("button", name="Remove this row").click()
        editor.get_by_role("button", name="Save").click()
        expect(page.get_by_text("1 reported row saved.")).to_be_visible()
        expect(editor.get_by_role("alert")).to_be_empty()
    with platform.database.reading() as session:
        rows = reported_in(session, place.phase.id)
    assert [(row.method, row.modality, row.miou, row.iou_t) for row in rows] == [("Paper 0", "C+L", 0.342, None)]
    assert [(row.note, row.percent_digits) for row in rows] == [("of another split", 1)]


def test_rules_that_are_refused_say_why_and_the_benchmark_is_made_public(
    site: Site, platform: Platform, administrator: Person, place: Place
) -> None:
    with site.visit(administrator, expected=["409", "422"]) as page:
        page.goto(address(place))
        page.get_by_role("button", name="Edit rules").click()
        look(page, "admin-phase-rules")
        asking = page.get_by_role("dialog")
        asking.get_by_label("Closes").fill("1900-10-01T00:00")
        give_reason(page, "a slip of the keys", "Save")
        expect(asking.get_by_role("alert")).to_contain_text("closes_at: the year is 1900; expected 1970 to 2200")
        expect(asking.get_by_role("alert")).not_to_contain_text(re.compile("Value error|value error|expected the year"))
        asking.get_by_label("Closes").fill("2199-10-01T00:00")
        asking.get_by_label("Submissions per window").fill("")
        asking.get_by_label("Submissions in total").fill("40")
        give_reason(page, "one month more", "Save")
        expect(asking.get_by_role("alert")).to_contain_text("has no sequence in val")
        page.keyboard.press("Escape")
        expect(page.get_by_role("dialog")).to_have_count(0)
        page.goto(address(place).rpartition("/")[0])
        look(page, "admin-benchmark")
        page.get_by_role("button", name="Make public").click()
        give_reason(page, "the season begins", "Make public")
        expect(page.get_by_role("button", name="Hide from visitors")).to_be_visible()
        page.goto("/admin/benchmarks")
        expect(page.get_by_text("public", exact=True)).to_be_visible()
        look(page, "admin-benchmarks")
    with platform.database.reading() as session:
        assert session.scalars(select(Benchmark)).one().is_public


def test_without_a_version_the_page_says_what_to_do_first(site: Site, administrator: Person) -> None:
    with site.visit(administrator) as page:
        page.goto("/admin/benchmarks")
        expect(page.get_by_role("link", name="Publish a version first.")).to_be_visible()
