"""The split editor: moved by keys, by dragging and by selects, judged live, saved once; a version of the dataset."""

import httpx
import pytest
from playwright.sync_api import Dialog, Locator, Page, expect

from services.domain.datasets.splits import current_splits
from services.domain.datasets.statistics import Record
from services.runtime.platform import Platform
from stone.splits.splits import Split
from testing.api.serving import Person
from testing.web.browsing import Site
from tests.web.dataset_world import CAMPAIGN, Driven, campaign, chunks, put, put_apart
from tests.web.looking import look, serious_findings
from web.pages.dataset import LARGEST_PX, figure_of

URL = "/dataset/splits"


@pytest.fixture
def sequences(platform: Platform, curator: Person) -> tuple[Driven, ...]:
    return campaign(platform, curator)


def column(page: Page, name: str) -> Locator:
    """The names of the sequences in a column."""
    return page.get_by_role("region", name=name, exact=True).locator(".split-name")


def column_of(page: Page, name: str) -> Locator:
    return page.get_by_role("region", name=name, exact=True)


def standing(platform: Platform) -> Split:
    with platform.database.reading() as session:
        return current_splits(session).split


def test_sequences_are_moved_by_keys_judged_at_once_and_saved_unless_somebody_else_did(
    site: Site, administrator: Person, sequences: tuple[Driven, ...]
) -> None:
    split = put_apart(site.platform, sequences)
    plot = next(one for one in sequences if one.name == "farmland-03")
    with site.visit(administrator, expected=["412"]) as page:
        page.goto(URL)
        verdict = page.locator("[data-verdict]")
        expect(verdict).to_have_text("All rules satisfied")
        page.get_by_role("button", name="farmland-03").press("3")
        expect(verdict).to_have_text("One rule is violated")
        expect(page.get_by_role("status").first).to_have_text("farmland-03 is in test now.")
        expect(page.locator("[data-findings]")).to_contain_text("Gyeonggi")
        expect(column(page, "Test").filter(has_text="farmland-03")).to_have_count(1)
        expect(page.get_by_role("button", name="Save…")).to_be_disabled()
        page.get_by_role("button", name="farmland-03").press("0")
        expect(verdict).to_have_text("All rules satisfied")
        page.get_by_role("button", name="Save…").click()
        expect(page.get_by_role("dialog")).to_contain_text("farmland-03: train → unassigned")
        page.get_by_label("Reason").fill("the lake was dry")
        body = {"train": split.train, "val": split.val, "test": split.test, "reason": "as it was"}
        headers = {**administrator.headers, "If-Match": '"1"'}
        assert httpx.put(f"{site.url}/api/v1/splits", json=body, headers=headers).status_code == 200
        page.get_by_role("dialog").get_by_role("button", name="Save").click()
        notice = page.get_by_role("alert").filter(has_text="saved the splits while you worked")
        expect(notice).to_contain_text(administrator.name)
        expect(notice).to_contain_text("farmland-03 (unassigned here, train there)")
        notice.get_by_role("button", name="Keep mine").click()
        page.get_by_role("button", name="Save…").click()
        page.get_by_label("Reason").fill("the lake was dry")
        page.get_by_role("dialog").get_by_role("button", name="Save").click()
        expect(page.locator("[data-changes]")).to_have_text("Revision 3")
    assert plot.id not in {one for ids in standing(site.platform).parts.values() for one in ids}


def test_cards_are_moved_by_arrows_by_mouse_and_by_select_and_leaving_asks_first(
    site: Site, administrator: Person, sequences: tuple[Driven, ...]
) -> None:
    names = sorted(one.name for one in sequences)
    asked: list[str] = []

    def leave(dialog: Dialog) -> None:
        asked.append(dialog.type)
        dialog.accept()

    with site.visit(administrator) as page:
        page.goto(URL)
        expect(page.locator("[data-verdict]")).to_have_text("No sequence is in a split yet")
        page.get_by_role("button", name=names[0]).focus()
        for key in ("Space", "ArrowDown", "Space", "2"):
            page.keyboard.press(key)
        expect(column(page, "Val")).to_have_text(names[:2])
        expect(page.get_by_role("button", name=names[2])).to_be_focused()
        page.keyboard.press("Shift+ArrowLeft")
        expect(column(page, "Test")).to_have_text(names[2:3])
        expect(page.get_by_role("button", name=names[2])).to_be_focused()
        page.keyboard.press("ArrowLeft")
        expect(page.get_by_role("button", name=names[0])).to_be_focused()
        page.keyboard.press("Control+z")
        page.keyboard.press("Control+z")
        expect(column(page, "Unassigned")).to_have_text(names)
        expect(page.get_by_role("button", name="Undo")).to_be_disabled()
        train = page.get_by_role("region", name="Train", exact=True)
        page.locator(f'[data-name="{names[0]}"]').drag_to(train, target_position={"x": 60, "y": 60})  # in sight
        expect(column(page, "Train")).to_have_text(names[:1])
        page.get_by_role("button", name=names[1]).focus()
        page.get_by_label(f"Split of {names[1]}").select_option("test")
        expect(column(page, "Test")).to_have_text(names[1:2])
        page.get_by_role("searchbox").fill("lake night")
        expect(page.locator(".split-card:visible")).to_have_count(1)
        page.on("dialog", leave)
        page.goto("/sign-in")
        assert asked == ["beforeunload"]


def test_a_drive_is_one_folded_card_that_moves_all_of_its_sequences(
    site: Site, administrator: Person, curator: Person
) -> None:
    drives = chunks(site.platform, curator, drives=31, each=9)
    torn = Split(train=(*drives[0][:6], *drives[1]), test=drives[0][6:])
    put(site.platform, torn)
    with site.visit(administrator) as page:
        page.goto(URL)
        expect(page.locator("[data-count]")).to_have_text(["15", "0", "3", "261"])
        expect(page.locator(".split-card:visible")).to_have_count(32)
        expect(page.locator("[data-findings]")).to_contain_text("drive 'run-00-0' is divided")
        amounts = column_of(page, "Train").locator("[data-drive-amount]")
        expect(amounts).to_have_text(["6 of 9 sequences · 1,200 frames · 120 s", "9 sequences · 1,800 frames · 180 s"])
        for width_px, limit_px in ((1280, 5000), (390, 7000)):
            page.set_viewport_size({"width": width_px, "height": 900})
            assert page.evaluate("document.documentElement.scrollHeight") < limit_px
        page.set_viewport_size({"width": 1280, "height": 900})
        column_of(page, "Train").get_by_role("button", name="Drive run-00-0", exact=True).press("3")
        expect(page.get_by_role("status").first).to_have_text("Drive run-00-0, 9 sequences, is in test now.")
        expect(page.locator("[data-count]")).to_have_text(["9", "0", "9", "261"])
        expect(column_of(page, "Test").locator("[data-from]").first).to_have_text("from train, test")
        expect(page.locator("[data-findings]")).not_to_contain_text("torn")
        expect(page.get_by_role("button", name="Drive run-01-0", exact=True)).to_be_focused()
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.locator(".split-card:visible")).to_have_count(31 + 9)
        page.get_by_role("button", name="run-01-4", exact=True).press("2")
        expect(column_of(page, "Val").locator("[data-drive-amount]")).to_have_text(
            "1 of 9 sequences · 200 frames · 20 s"
        )
        expect(page.locator("[data-findings]")).to_contain_text("drive 'run-01-0' is divided")
        page.get_by_label("Split of drive run-01-0").first.select_option("val")
        expect(page.locator("[data-count]")).to_have_text(["0", "9", "9", "261"])
        for _ in range(3):
            page.keyboard.press("Control+z")
        expect(page.locator("[data-count]")).to_have_text(["15", "0", "3", "261"])
        expect(amounts).to_have_text(["6 of 9 sequences · 1,200 frames · 120 s", "9 sequences · 1,800 frames · 180 s"])
        page.get_by_role("searchbox").fill("run-01")
        expect(page.locator(".split-drive:visible")).to_have_count(1)
        look(page, "splits-of-drives")
        page.get_by_role("searchbox").fill("")
        page.set_viewport_size({"width": 390, "height": 844})
        page.get_by_label("Split of drive run-00-0").first.select_option("test")
        expect(page.locator("[data-count]")).to_have_text(["9", "0", "9", "261"])
    with site.visit(curator) as page:
        page.goto(URL)
        page.get_by_role("button", name="Sequences of drive run-05-0").click()
        expect(page.get_by_role("link", name="run-05-3", exact=True)).to_be_visible()


def test_a_proposal_is_shown_and_adopted_before_anything_is_saved(
    site: Site, administrator: Person, sequences: tuple[Driven, ...]
) -> None:
    with site.visit(administrator) as page:
        page.goto(URL)
        page.get_by_role("button", name="Propose…").click()
        for part, size in (("Train", "5"), ("Val", "4"), ("Test", "4")):
            page.get_by_role("spinbutton", name=part).fill(size)
        assert serious_findings(page) == []
        page.get_by_role("button", name="Propose", exact=True).click()
        expect(page.get_by_role("button", name="Adopt")).to_be_focused(timeout=300_000)
        expect(page.get_by_role("heading", name="A proposal that satisfies every rule")).to_be_visible()
        page.get_by_role("button", name="Adopt").click()
        for part, wanted in (("Train", 5), ("Val", 4), ("Test", 4)):
            expect(column(page, part)).to_have_count(wanted)
        expect(page.locator("[data-changes]")).to_have_text("13 moved, not saved")
    assert standing(site.platform) == Split()


def test_an_administrator_sees_what_a_version_will_hold_and_publishes_it(
    site: Site, administrator: Person, sequences: tuple[Driven, ...]
) -> None:
    with site.visit(administrator) as page:
        page.goto("/dataset/new")
        expect(page.get_by_role("button", name="Publish", exact=True)).to_have_count(0)
        put_apart(site.platform, sequences)
        page.reload()
        page.get_by_text("Quality of the labels", exact=True).click()
        rows = page.get_by_role("region", name="Quality of the labels").get_by_role("row")
        expect(rows).to_have_count(1 + len(sequences))
        expect(rows.last).to_contain_text("97.3 % of 75 m")
        page.get_by_label("Version").fill("stone-1.0")
        page.get_by_label("Licence").fill("CC-BY-4.0")
        page.get_by_label("Reason").fill("first release")
        page.get_by_role("button", name="Publish", exact=True).click()
        expect(page.get_by_role("heading", name="stone-1.0", exact=True)).to_be_visible(timeout=300_000)
        expect(page.locator(".lead")).to_contain_text("CC-BY-4.0")


def record(frames: int, environment: str = "lake") -> Record:
    ratios = {"traversable": 0.25, "potentially_traversable": 0.25, "non_traversable": 0.5}
    sums = {"sequences": 1, "frames": frames, "distance_m": 100.0, "class_ratios": ratios}
    cells = [{"environment": environment, "illumination": "night", **sums}]
    cells.append({"environment": environment, "illumination": "day", **sums, "frames": 400, "class_ratios": None})
    return {"cells": cells, "environments": [{"key": environment, **sums}]}


def test_areas_are_frames_and_stripes_are_classes() -> None:
    figure = figure_of(record(100))
    (line,) = [line for line in figure.lines if line.squares]
    day, night = line.squares
    assert (day.side_px, night.side_px) == (LARGEST_PX, LARGEST_PX / 2)
    assert [stripe.height_px / night.side_px for stripe in night.stripes] == [0.25, 0.25, 0.5]
    assert [stripe.kind for stripe in day.stripes] == ["unseen"]


def test_a_place_that_nobody_drove_in_has_a_line_of_its_own() -> None:
    assert len(figure_of(record(100, "")).lines) == len({place for place, _, _ in CAMPAIGN}) + 1
    assert [line.squares for line in figure_of({"cells": [], "environments": []}).lines] == [()] * 4
