"""The dataset's pages in a browser: its composition, its versions with their downloads, publishing one."""

import json
from pathlib import Path

import pytest
from playwright.sync_api import expect

from services.domain.datasets.statistics import Record
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds import published
from tests.web.dataset_world import CAMPAIGN, Driven, campaign, put_apart
from tests.web.looking import look
from web.pages.dataset_figure import LARGEST_PX, figure_of


@pytest.fixture
def sequences(platform: Platform, curator: Person) -> tuple[Driven, ...]:
    return campaign(platform, curator)


def test_a_version_shows_what_it_is_made_of_and_is_downloaded(
    site: Site, administrator: Person, participant: Person, sequences: tuple[Driven, ...]
) -> None:
    parts = {"train": [one.id for one in sequences[:9]], "val": [sequences[9].id], "test": [sequences[12].id]}
    published.dataset(site.platform, administrator.user_id, parts, "stone-1.0")
    with site.visit(participant) as page:
        page.goto("/dataset")
        expect(page.get_by_role("heading", name="stone-1.0", exact=True)).to_be_visible()
        expect(page.locator(".composition .square")).to_have_count(11)
        expect(page.get_by_text("classes withheld")).to_be_visible()
        look(page, "dataset")
        with page.expect_download() as downloading:
            page.get_by_role("link", name="Manifest").click()
        manifest = json.loads(Path(downloading.value.path()).read_text("utf-8"))
        assert manifest["version"] == "stone-1.0"
        page.get_by_text("Table", exact=True).click()
        page.get_by_text("11 sequences", exact=True).click()
        expect(page.get_by_role("row", name="night 3")).to_be_visible()
        look(page, "dataset-numbers")


def test_an_administrator_sees_what_a_version_will_hold_and_publishes_it(
    site: Site, administrator: Person, sequences: tuple[Driven, ...]
) -> None:
    with site.visit(administrator) as page:
        page.goto("/dataset/new")
        expect(page.get_by_role("heading", name="Cannot be published yet")).to_be_visible()
        look(page, "dataset-new-refused")
        put_apart(site.platform, sequences)
        page.reload()
        expect(page.get_by_text("files of train and val")).to_be_visible()
        look(page, "dataset-new")
        page.get_by_label("Version").fill("stone-1.0")
        page.get_by_label("Licence").fill("CC-BY-4.0")
        page.get_by_label("Reason").fill("first release")
        page.get_by_role("button", name="Publish", exact=True).click()
        expect(page.get_by_role("heading", name="stone-1.0", exact=True)).to_be_visible(timeout=300_000)
        expect(page.locator(".lead")).to_contain_text("CC-BY-4.0")
        page.goto("/dataset?version=")
        look(page, "dataset-work")


def test_without_a_version_or_labels_the_page_says_what_to_do(site: Site, participant: Person, curator: Person) -> None:
    for who, link in ((participant, "browse the public sequences"), (curator, "appear here once they are labelled")):
        with site.visit(who) as page:
            page.goto("/dataset")
            expect(page.locator(".empty").filter(has_text=link).get_by_role("link", name="Sequences")).to_be_visible()
            look(page, f"dataset-empty-{link[:2].lower()}")


def test_a_version_that_is_not_there_is_404(site: Site, participant: Person) -> None:
    with site.visit(participant, expected=["404"]) as page:
        answer = page.goto("/dataset?version=nothing")
        assert answer is not None
        assert answer.status == 404


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
