"""The 3D viewer as people use it: by keys, by mouse, on a phone, and where there is nothing to see."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect
from sqlalchemy import delete

from services.runtime.orm import Artefact, SequenceRow
from services.runtime.platform import Platform
from stone.labels.voxels import VOXEL_M
from testing.api.serving import Person
from testing.stone_serve import until
from testing.web.browsing import Site
from testing.worlds.viewer_world import LIMIT, Run, viewed
from tests.web.looking import look

RUN = Run(frames=6, reach_m=4.5)


@pytest.fixture
def seen(site: Site, curator: Person) -> dict[str, Any]:
    return viewed(site.platform, curator, RUN, has_clouds=True)


@pytest.fixture
def at_viewer(site: Site, curator: Person, seen: dict[str, Any]) -> Iterator[Page]:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(host(page)).to_have_attribute("data-state", "ready")
        yield page


def host(page: Page) -> Locator:
    return page.locator("[data-viewer]")


def canvas(page: Page) -> Locator:
    return page.get_by_role("application")


def test_keys_step_through_the_frames_and_the_address_follows(at_viewer: Page, seen: dict[str, Any]) -> None:
    tokens = seen["tokens"]
    expect(host(at_viewer)).to_have_attribute("data-frame", "1")
    canvas(at_viewer).focus()
    at_viewer.keyboard.press(".")
    expect(host(at_viewer)).to_have_attribute("data-frame", "2")
    expect(at_viewer).to_have_url(f"/sequences/{seen['id']}/view?frame={tokens[2]}")
    at_viewer.keyboard.press("End")
    expect(host(at_viewer)).to_have_attribute("data-frame", "5")
    at_viewer.keyboard.press(",")
    expect(at_viewer.get_by_text("5 / 6 · 0.4 s")).to_be_visible()
    slider = at_viewer.get_by_label("Frame", exact=True)
    slider.press("Home")
    expect(slider).to_have_attribute("aria-valuetext", "Frame 1 of 6, 0.0 s")
    canvas(at_viewer).press("Space")
    expect(host(at_viewer)).to_have_attribute("data-frame", "5")
    expect(at_viewer.get_by_role("button", name="Play")).to_be_visible()
    look(at_viewer, "viewer")


def test_a_crosshair_picks_by_keys_what_a_click_picks_and_says_what_the_tile_says(at_viewer: Page) -> None:
    canvas(at_viewer).focus()
    at_viewer.keyboard.press("c")
    at_viewer.keyboard.press("Shift+ArrowDown")
    expect(at_viewer.locator(".viewer-readout")).to_be_visible()
    until(lambda: readout(at_viewer) == expected(readout(at_viewer)["Map position"]))
    by_keys = readout(at_viewer)
    at_viewer.keyboard.press("Escape")
    expect(at_viewer.locator(".viewer-readout")).to_be_hidden()
    box = canvas(at_viewer).bounding_box()
    assert box is not None
    at_viewer.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2 + 40)
    expect(at_viewer.locator(".viewer-readout")).to_be_visible()
    assert readout(at_viewer) == by_keys
    look(at_viewer, "viewer-picked")


def readout(page: Page) -> dict[str, str]:
    shown = page.locator(".viewer-readout")
    names, values = shown.locator("dt").all_text_contents(), shown.locator("dd").all_text_contents()
    return dict(zip(names, values, strict=True)) | {"class": shown.locator("h3").inner_text()}


def expected(place: str) -> dict[str, str]:
    """What the tile holds at the voxel whose centre is next to this place of the map, in the readout's words."""
    tile = RUN.voxels
    at = np.array([float(value) for value in place.removesuffix(" m").split(",")])
    row = int(np.argmin(np.linalg.norm((tile.indices + 0.5) * VOXEL_M - at, axis=1)))
    elevation, slope, rough = tile.features[row]
    d2 = tile.distance_squared[row]
    names = {1: "Traversable", 2: "Potentially traversable", 3: "Non-traversable"}
    return {
        "Elevation": f"{elevation:.2f} m",
        "Slope": f"{np.degrees(slope):.1f}°",
        "Roughness": f"{1000 * np.exp(rough / 2):.0f} mm (log {rough:.1f})",
        "D²": f"{d2:.1f}",
        "Map position": place,
        "class": names[int(tile.classes[row])],
    }


def test_colours_layers_and_the_whole_run_are_chosen_in_the_panel(at_viewer: Page) -> None:
    legend = at_viewer.locator(".viewer-legend")
    expect(legend).to_contain_text("Non-traversable")
    at_viewer.get_by_label("Colour by").select_option("d2")
    expect(legend).to_contain_text(f"{LIMIT:.1f} (limit)")
    at_viewer.get_by_label("Show", exact=True).select_option("map")
    with at_viewer.expect_response(lambda answer: "/scene/meshes/0_0" in answer.url) as surface:
        at_viewer.get_by_label("Surface").check()
    with at_viewer.expect_response(lambda answer: "/cloud" in answer.url) as cloud:
        at_viewer.get_by_label("Point cloud").check()
    assert surface.value.ok
    assert cloud.value.ok
    at_viewer.locator("summary").click()
    look(at_viewer, "viewer-heat")


def test_of_imported_labels_a_voxel_says_its_class_and_that_nothing_explains_it(site: Site, curator: Person) -> None:
    seen = viewed(site.platform, curator, Run(frames=2, reach_m=3.0, is_imported=True))
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(host(page)).to_have_attribute("data-state", "ready")
        canvas(page).focus()
        page.keyboard.press("c")
        page.keyboard.press("Shift+ArrowDown")
        expect(page.locator(".viewer-readout")).to_contain_text("Imported labels have no features")
        assert set(readout(page)) == {"Map position", "class"}
        page.locator("summary").click()
        assert page.get_by_label("Colour by").locator("option").all_inner_texts() == ["Class"]
        expect(page.get_by_text("D², slope and roughness are not available")).to_be_visible()
        look(page, "viewer-imported")


def test_a_visitor_looks_at_what_is_public_and_the_page_and_its_viewer_tell_each_other_the_frame(
    site: Site, seen: dict[str, Any]
) -> None:
    with site.platform.database.transaction() as session:
        session.get_one(SequenceRow, seen["id"]).is_public = True
    with site.visit() as page:
        page.goto(f"/sequences/{seen['id']}/view")
        expect(host(page)).to_have_attribute("data-state", "ready")
        told = page.evaluate(
            """() => new Promise(tell => {
                const host = document.querySelector("[data-viewer]");
                host.addEventListener("frame", ({ detail }) => tell(detail), { once: true });
                host.dispatchEvent(new CustomEvent("show-frame", { detail: { index: 3 } }));
            })"""
        )
        assert told == {"index": 3, "token": seen["tokens"][3]}


def test_a_browser_without_webgl_shows_the_frames_from_above(site: Site, curator: Person, seen: dict[str, Any]) -> None:
    with site.visit(curator) as page:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
        page.goto(f"/sequences/{seen['id']}/view")
        expect(host(page)).to_have_attribute("data-state", "picture")
        expect(page.get_by_text("3D is not available")).to_be_visible()
        page.get_by_role("button", name="Next frame").click()
        expect(page.get_by_role("img", name="frame 2 of 6")).to_be_visible()
        look(page, "viewer-pictures")


def test_a_sequence_without_labels_says_what_to_do(site: Site, curator: Person) -> None:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{_bare(site.platform, curator)}/view")
        expect(page.get_by_role("heading", name="No labels yet")).to_be_visible()
        expect(page.get_by_role("link", name="Sequence", exact=True)).to_be_visible()
        look(page, "viewer-empty")


def test_labels_made_before_there_was_a_viewer_say_so(site: Site, curator: Person, seen: dict[str, Any]) -> None:
    with site.platform.database.transaction() as session:
        session.execute(delete(Artefact).where(Artefact.name == "scene/scene.json"))
    with site.visit(curator, expected=["404"]) as page:
        page.goto(f"/sequences/{seen['id']}/view")
        expect(host(page)).to_have_attribute("data-state", "empty")
        expect(page.get_by_text("process the sequence again")).to_be_visible()


def test_a_frame_that_does_not_come_is_said_in_the_picture(at_viewer: Page, seen: dict[str, Any]) -> None:
    last = f"**/frames/{seen['tokens'][-1]}/voxels?*"
    at_viewer.route(last, lambda route: route.fulfill(body=b"not zstd"))
    at_viewer.reload()  # it may have been fetched ahead
    expect(host(at_viewer)).to_have_attribute("data-state", "ready")
    at_viewer.get_by_label("Frame", exact=True).press("End")
    expect(at_viewer.locator(".viewer-said")).to_contain_text("Frame 6 cannot be shown")


def test_a_private_sequence_is_shown_in_3d_to_nobody_else(
    site: Site, participant: Person, seen: dict[str, Any]
) -> None:
    for who, status in ((participant, 404), (None, 401)):
        with site.visit(who, expected=[str(status)]) as page:
            answer = page.goto(f"/sequences/{seen['id']}/view")
            assert answer is not None
            assert answer.status == status


def _bare(platform: Platform, owner: Person) -> str:
    with platform.database.transaction() as session:
        row = SequenceRow(owner_id=owner.user_id, name="not-yet", environment="meadow", illumination="day")
        session.add(row)
        session.flush()
        return row.id
