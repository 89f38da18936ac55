"""The address of the 3D view, its differences of two label sets, colours of points; its camera is above the ground."""

from collections.abc import Iterator
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from services.runtime.orm import SequenceRow
from testing.api.serving import Person
from testing.stone_serve import until
from testing.web.browsing import Site
from testing.worlds.viewer_world import Run, viewed
from tests.web.test_viewer import canvas, host
from tests.web.test_viewer_cameras import VIEWER, strip
from tests.web.test_viewer_data import IMPORTS, run
from tests.web.test_viewer_differences import Pair, pair

__all__ = ["pair"]
RUN = Run(frames=6, reach_m=4.5)
VIEW = f"async () => {{ {IMPORTS} {VIEWER} return viewer.world.viewpoint; }}"


@pytest.fixture
def seen(site: Site, curator: Person) -> dict[str, Any]:
    return viewed(site.platform, curator, RUN, has_clouds=True, has_cameras=True)


@pytest.fixture
def at_viewer(site: Site, curator: Person, seen: dict[str, Any]) -> Iterator[Page]:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(strip(page)).to_have_attribute("data-frame", "1")
        yield page


def chosen(page: Page) -> dict[str, Any]:
    """What the panel says, and where the camera stands."""
    selects = page.locator(".viewer-panel select").evaluate_all("all => all.map(one => one.value)")
    checks = page.locator(".viewer-panel input").evaluate_all("all => all.map(one => one.checked)")
    return {
        "selects": selects,
        "checks": checks,
        "view": page.evaluate(VIEW),
        "frame": host(page).get_attribute("data-frame"),
    }


def says_where_it_stands(page: Page) -> bool:
    """Whether the address, which is written a while after the last change, has come to the camera's view."""
    said = parse_qs(urlsplit(page.evaluate("location.href")).query).get("at", [""])[0]
    return bool(said) and [float(value) for value in said.split(",")] == pytest.approx(page.evaluate(VIEW), rel=1e-3)


def test_an_address_that_is_copied_shows_the_same_frame_layers_colours_and_view(
    site: Site, curator: Person, at_viewer: Page
) -> None:
    """Catches alone what is written into the address and not read, or read and not shown in the panel."""
    page = at_viewer
    page.get_by_label("Colour by").select_option("slope")
    page.get_by_label("Voxels not observed").select_option("hide")
    page.get_by_label("Non-traversable").uncheck()
    page.get_by_label("Surface").check()
    page.get_by_label("Point cloud").check()
    page.get_by_label("Track").uncheck()
    page.get_by_label("Points by").select_option("height")
    page.get_by_label("Cameras").select_option("plain")
    canvas(page).focus()
    for key in ("f", "Shift+ArrowLeft", "ArrowUp", "d", "+", "."):
        page.keyboard.press(key)
    expect(host(page)).to_have_attribute("data-frame", "2")
    until(
        lambda: (
            says_where_it_stands(page)
            and all(
                part in page.evaluate("location.href")
                for part in ("colour=slope", "hide=n", "points=height", "follow=off")
            )
        )
    )
    before, address = chosen(page), page.evaluate("location.href")
    with site.visit(curator) as other:
        other.goto(address)
        expect(strip(other)).to_have_attribute("data-frame", "2")
        after = chosen(other)
        assert {**after, "view": None} == {**before, "view": None}
        assert after["view"] == pytest.approx(before["view"], rel=2e-3, abs=2e-3)
        other.wait_for_timeout(600)
        assert other.evaluate("location.href") == address


def test_a_camera_that_the_robot_left_behind_stands_there_in_the_address_too(
    site: Site, curator: Person, at_viewer: Page
) -> None:
    """Catches alone an address that says where the camera is only where the reader moved it."""
    for key in ("f", "."):
        canvas(at_viewer).press(key)
    expect(host(at_viewer)).to_have_attribute("data-frame", "2")
    until(lambda: "at=" in at_viewer.evaluate("location.href"))
    with site.visit(curator) as other:
        other.goto(at_viewer.evaluate("location.href"))
        expect(strip(other)).to_have_attribute("data-frame", "2")
        assert other.evaluate(VIEW) == pytest.approx(at_viewer.evaluate(VIEW), rel=2e-3, abs=2e-3)


def test_nonsense_in_an_address_is_read_as_if_it_were_not_there(
    site: Site, curator: Person, seen: dict[str, Any]
) -> None:
    said = (
        "colour=mauve&show=everything&hide=x&unseen=&layers=lasers,labels,track,robot,grid&cameras=7&at=1,2,x&points=q"
    )
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][0]}&{said}&camera=CAM_MOON")
        expect(strip(page)).to_have_attribute("data-frame", "0")
        expect(page).to_have_url(f"/sequences/{seen['id']}/view?frame={seen['tokens'][0]}")
        expect(page.get_by_label("Colour by")).to_have_value("class")


def test_while_frames_play_the_address_is_left_alone(at_viewer: Page) -> None:
    """Browsers refuse more than a hundred changes in half a minute."""
    at_viewer.evaluate(
        """() => { window.writes = 0; const replace = history.replaceState.bind(history);
          history.replaceState = (...given) => { window.writes += 1; replace(...given); }; }"""
    )
    canvas(at_viewer).press("Space")
    expect(host(at_viewer)).to_have_attribute("data-frame", "5")
    expect(at_viewer.get_by_role("button", name="Play")).to_be_visible()
    token = at_viewer.evaluate(TOKEN)
    until(lambda: at_viewer.evaluate("location.href").endswith(f"frame={token}"))
    assert 1 <= at_viewer.evaluate("window.writes") <= 5


TOKEN = f"async () => {{ {IMPORTS} {VIEWER} return viewer.scene.frames.tokens[5]; }}"


def test_the_camera_is_never_below_the_ground(at_viewer: Page) -> None:
    """Dragged up as far as it goes, and moved over the hills: at every step it is above the lowest label below it."""
    script = f"""async () => {{ {IMPORTS} {VIEWER}
      const {{ stage, world }} = viewer, {{ orbit, camera }} = stage, gaps = [];
      const look = () => {{
        orbit.place();
        gaps.push(camera.position.z - orbit.floor(camera.position.x, camera.position.y),
                  orbit.target.z - orbit.floor(orbit.target.x, orbit.target.y) + 0.5);
      }};
      for (let n = 0; n < 40; n++) {{ orbit.turn(0.3, -0.2); look(); }}
      for (let n = 0; n < 40; n++) {{ orbit.near(0.9); orbit.slide(0, 0.1); look(); }}
      for (let n = 0; n < 60; n++) {{ orbit.turn(0.2, 0); orbit.slide(0.3, 0.2); look(); }}
      return gaps; }}"""
    gaps = at_viewer.evaluate(script)
    assert len(gaps) == 280
    assert min(gaps) >= 0.5 - 1e-6


def test_the_floor_is_the_lowest_label_of_each_square(at_viewer: Page, seen: dict[str, Any]) -> None:
    grid = RUN.grids[1]
    script = f"""async given => {{ {IMPORTS}
      const {{ columnsOf, lowestOf }} = await load("data/columns"), {{ planesOf }} = await load("data/formats");
      const planes = planesOf(await fetched(`/api/v1/frames/${{given}}/voxels`));
      return Array.from(lowestOf(columnsOf(planes, false))); }}"""
    found = at_viewer.evaluate(script, seen["tokens"][1])
    squares = np.asarray(grid.reshape(64, 4, 64, 4, 32).any(axis=(1, 3)))
    lowest = np.where(squares.any(axis=2), squares.argmax(axis=2), -1)
    assert found == lowest.ravel().tolist()


def test_a_slope_beyond_upright_is_called_an_overhang(at_viewer: Page) -> None:
    script = """
    const { valuesOf, reason } = await load("controls/explanation");
    const covariance = [[1, 0, 0], [0, .01, 0], [0, 0, 1]];
    const scene = { profile: "paper", reference: { mean: [0, .09, -9], covariance, d2_limit: 7.8 } };
    const found = slope_rad => ({ elevation_m: 0, slope_rad, roughness: -9, d2: 300 });
    const picked = slope_rad => ({ kind: 3, seen: true, found: found(slope_rad) });
    return given.map(slope => [Object.fromEntries(valuesOf(found(slope), scene)).Slope, reason(picked(slope), scene)]);
    """
    (over, said), (upright, plain) = run(at_viewer, script, [1.95, 1.5707963705])
    assert over == "111.7° (overhang: the surface faces down)"
    assert "slope (112°, an overhang, against 5° ± 6°)" in said
    assert upright == "90.0°"
    assert "overhang" not in plain


def test_points_are_coloured_by_height_and_by_age_and_the_legend_says_how(at_viewer: Page) -> None:
    legend = at_viewer.locator(".viewer-corner")
    at_viewer.get_by_label("Point cloud").check()
    at_viewer.get_by_label("Points by").select_option("height")
    expect(legend).to_contain_text("Points, height")
    at_viewer.get_by_label("Points by").select_option("time")
    expect(legend).to_contain_text("Points, age")
    count = f"""async () => {{ {IMPORTS} {VIEWER}
      return viewer.world.cloud.group.children.filter(one => one.visible).length; }}"""
    until(lambda: at_viewer.evaluate(count) == 1)
    for shown in (2, 3):
        canvas(at_viewer).press(".")
        until(lambda shown=shown: at_viewer.evaluate(count) == shown)  # type: ignore[misc]
    at_viewer.get_by_label("Points by").select_option("intensity")
    until(lambda: at_viewer.evaluate(count) == 1)


def test_where_there_are_two_label_sets_their_difference_is_offered_to_who_may_compare(
    site: Site, curator: Person, pair: Pair
) -> None:
    plain = f"/sequences/{pair.sequence_id}/view?frame={pair.tokens[0]}"
    with site.platform.database.transaction() as session:
        session.get_one(SequenceRow, pair.sequence_id).is_public = True
    with site.visit(curator) as page:
        page.goto(plain)
        expect(host(page)).to_have_attribute("data-state", "ready")
        expect(page.get_by_label("Colour by")).to_have_value("class")
        expect(page.get_by_role("link", name="2 label sets")).to_be_visible()
        page.get_by_label("Colour by").select_option("difference")
        expect(page.locator(".viewer-legend li").first).to_contain_text("The same class")
    with site.visit() as page:
        page.goto(plain)
        expect(host(page)).to_have_attribute("data-state", "ready")
        assert "difference" not in page.get_by_label("Colour by").locator("option").evaluate_all(
            "all => all.map(o => o.value)"
        )
        expect(page.get_by_role("link", name="2 label sets")).to_have_count(0)
