"""Layers of the 3D view: what is cut by height, colours of points, radar, the whole run; and the menu of a phone."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Error as PlaywrightError
from playwright.sync_api import Page, Route, expect

from testing.api.serving import Person
from testing.stone_serve import until
from testing.web.browsing import PHONE, Site
from testing.worlds.viewer_world import BLOCK_M, Run, radar_of, viewed
from tests.web.looking import keep
from tests.web.test_viewer import VIEW, VIEWER, canvas, fill, host
from tests.web.test_viewer_data import IMPORTS

RUN = Run(frames=6, reach_m=4.5)
RANGE = f"async () => {{ {IMPORTS} {VIEWER} return viewer.world.cloud.shared.range.value.toArray(); }}"
CUTS = f"""async given => {{ {IMPORTS} {VIEWER}
  const look = {{ mode: "class", classes: 14, unseen: "show", heights_m: given.heights }};
  const {{ asking }} = viewer.world, token = given.token;
  const direct = drawn => {{
    let [from, to] = [Infinity, -Infinity];
    const {{ vertices, indices }} = drawn.faces;
    for (const at of indices) [from, to] = [Math.min(from, vertices[4 * at + 2]), Math.max(to, vertices[4 * at + 2])];
    return [from, to].map(z => z * drawn.voxel_m + drawn.corner_m[2]);
  }};
  const frame = await asking.ask({{ kind: "frame", token, content: null, look }});
  const tile = await asking.ask({{ kind: "draw-tile", name: "0_0", look, level: 0 }});
  const ray = {{ from_m: given.from, direction: [0, 0, -1] }};
  const pick = scope => asking.ask({{ kind: "pick", ray, scope, token, look }});
  return {{ frame: direct(frame), tile: direct(tile), picked: [await pick("frame"), await pick("map")] }}; }}"""
RADAR = f"""async () => {{ {IMPORTS} {VIEWER}
  const drawn = viewer.world.radar.group.children.find(one => one.visible);
  return ["position", "strength"].map(name => [...(drawn?.geometry.getAttribute(name).array ?? [])]); }}"""


@pytest.fixture
def seen(site: Site, curator: Person) -> dict[str, Any]:
    return viewed(site.platform, curator, RUN, has_clouds=True)


@pytest.fixture
def at_viewer(site: Site, curator: Person, seen: dict[str, Any]) -> Iterator[Page]:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(host(page)).to_have_attribute("data-state", "ready")
        yield page


def test_what_is_above_the_heights_that_are_shown_is_neither_drawn_nor_picked(
    at_viewer: Page, seen: dict[str, Any]
) -> None:
    """A box of 1.4 m stands on the ground: cut at a metre above the wheels it is lower, and its cut has a face."""
    page, pose = at_viewer, RUN.poses[1]
    low_x, low_y, high_x, high_y, _ = BLOCK_M
    page.get_by_label("Show", exact=True).select_option("map")  # its tiles come
    over = [(low_x + high_x) / 2 - 0.05, (low_y + high_y) / 2 - 0.05, 20.0]
    until(lambda: page.evaluate("performance.getEntriesByType('resource').some(one => one.name.includes('tiles'))"))
    given = {"token": seen["tokens"][1], "from": over, "heights": [None, 1.0]}
    until(lambda: found(page, given) is not None)
    cut, whole = found(page, given), found(page, {**given, "heights": [None, None]})
    assert (cut["frame"][1], cut["tile"][1]) < (whole["frame"][1], whole["tile"][1])
    assert cut["frame"][1] == pytest.approx(1.0, abs=0.101)
    nearest = RUN.poses[np.linalg.norm(RUN.poses[:, :2] - over[:2], axis=1).argmin()]
    for scope, picked in zip(("frame", "map"), cut["picked"], strict=True):
        wheels_m = pose[2] if scope == "frame" else nearest[2]
        top_m = picked["centre_m"][2] - wheels_m
        assert 0.6 < top_m < 1.0
        assert picked["kind"] == 3
    assert all(one["centre_m"][2] > 1.2 for one in whole["picked"])


def test_on_a_phone_the_views_are_a_menu_that_is_closed_until_it_is_wanted(at_viewer: Page) -> None:
    page = at_viewer
    expect(page.get_by_role("button", name="Views")).to_be_hidden()
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    menu, above = page.get_by_role("button", name="Views"), page.get_by_role("button", name="From above")
    expect(menu).to_have_attribute("aria-expanded", "false")
    expect(above).to_be_hidden()
    tools, scene = page.locator(".viewer-tools").bounding_box(), canvas(page).bounding_box()
    assert tools is not None
    assert scene is not None
    assert tools["width"] * tools["height"] < 0.04 * scene["width"] * scene["height"]
    menu.click()
    above.click()
    assert page.evaluate(VIEW)[1] == pytest.approx(np.pi / 2, abs=0.01)
    expect(above).to_be_hidden()
    keep(page, "viewer-phone")


def test_how_much_of_the_whole_run_is_drawn_is_said_until_all_of_it_is(at_viewer: Page) -> None:
    page, held = at_viewer, list[Route]()
    page.route("**/scene/tiles/*", lambda route: held.append(route))
    page.get_by_label("Show", exact=True).select_option("map")
    said = page.locator(".viewer-loading")
    expect(said).to_have_text("Whole run: 0 of 1 tiles")
    expect(page.get_by_role("progressbar", name="Tiles of the whole run")).to_be_visible()
    until(lambda: len(held) > 0)
    held[0].continue_()
    expect(said).to_be_hidden()
    assert page.evaluate(f"async () => {{ {IMPORTS} {VIEWER} return viewer.world.map.voxels.children.length; }}") == 1


def found(page: Page, given: dict[str, Any]) -> Any:
    try:
        return page.evaluate(CUTS, given)
    except PlaywrightError:  # the tile is not there yet
        return None


def test_points_are_coloured_between_the_values_of_the_legend(at_viewer: Page, seen: dict[str, Any]) -> None:
    """The range is a frame's intensities without 2 % at either end, or the reader's; the legend shows both."""
    page = at_viewer
    with page.expect_response(lambda answer: "/cloud" in answer.url):
        page.get_by_label("Point cloud").check()
    ticks = page.locator(".viewer-ticks span")
    random = np.random.default_rng(1)  # as the world draws places, then intensities
    random.uniform(-RUN.reach_m, RUN.reach_m, (4000, 2))
    strong = np.sort(np.rint(random.uniform(0, 255, 4000)))
    low, high = strong[round(0.02 * 3999)], strong[round(0.98 * 3999)]
    expect(ticks).to_have_text([f"{low:.0f}", f"{(low + high) / 2:.0f}", f"{high:.0f}"])
    until(lambda: page.evaluate(RANGE) == [low, high])
    fill(page, "Colours of points, to", "100")
    expect(ticks.last).to_have_text("100")
    assert page.evaluate(RANGE) == [low, 100]
    fill(page, "Colours of points, from", "120")  # holds nothing: it stays as it was
    assert page.evaluate(RANGE) == [low, 100]
    page.get_by_label("Points by").select_option("height")
    expect(ticks).to_have_text(["-2.0 m", "1.2 m", "4.4 m"])
    assert page.get_by_label("Colours of points, to", exact=True).input_value() == ""
    page.get_by_label("Points by").select_option("time")
    expect(ticks).to_have_text(["1 s", "0.5 s", "now"])
    expect(page.get_by_label("Colours of points, to", exact=True)).to_be_hidden()


def test_radar_detections_are_a_layer_of_their_own_coloured_by_their_speed(
    at_viewer: Page, seen: dict[str, Any]
) -> None:
    page = at_viewer
    with page.expect_response(lambda answer: f"{seen['tokens'][1]}/radar" in answer.url):
        page.get_by_label("Radar").check()
    expect(page.locator(".viewer-ticks span")).to_have_text(["0 m/s", "2.5 m/s", "5 m/s and more"])
    for number in (1, 2):
        expect(host(page)).to_have_attribute("data-frame", str(number))
        points, rates = radar_of(number)
        until(lambda points=points: len(page.evaluate(RADAR)[1]) == len(points))  # type: ignore[misc]
        places, strengths = page.evaluate(RADAR)
        assert places == (100 * points).ravel().tolist()
        assert strengths == [min(255, round(255 * abs(rate) / 5)) for rate in rates]
        page.keyboard.press(".")
    keep(page, "viewer-radar")
