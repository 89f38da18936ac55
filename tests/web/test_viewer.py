"""The 3D viewer as people use it: by keys, by mouse, by its address, and where there is little to see."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, expect
from sqlalchemy import delete

from services.domain.viewer.formats import TileVoxels
from services.domain.viewer.frame_picture import DIFFERENCE_RGB
from services.runtime.orm import Artefact, SequenceRow
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_RGB, PALETTES
from stone.scoring.agreement import DIFFERENCES, SAME, differences
from stone_base.label_grid import MAP_VOXEL_M, RELEASE
from testing.api.serving import Person
from testing.stone_serve import until
from testing.web.browsing import Site
from testing.worlds import made
from testing.worlds.benchmark_world import labels_npz
from testing.worlds.viewer_world import Grid, Run, viewed
from tests.web.looking import keep
from tests.web.test_viewer_data import IMPORTS

KINDS = {1: "Traversable", 2: "Potentially traversable", 3: "Non-traversable"}
RUN, SHORT = Run(frames=6, reach_m=4.5), Run(frames=2, reach_m=3.0)
VIEWER = "const viewer = (await load('mount')).viewerOf(document.querySelector('[data-viewer]'));"
VIEW = f"async () => {{ {IMPORTS} {VIEWER} return viewer.world.viewpoint; }}"
TOKEN = f"async () => {{ {IMPORTS} {VIEWER} return viewer.scene.frames.tokens[5]; }}"
SWEEPS = f"""async () => {{ {IMPORTS} {VIEWER}
  return viewer.world.cloud.group.children.filter(one => one.visible).length; }}"""
# The colour of the palette's first entry, which is traversable, or no difference.
FIRST_COLOUR = f"async () => {{ {IMPORTS} {VIEWER} return [...viewer.world.paint.palette.image.data.slice(4, 7)]; }}"
# The camera dragged up as far as it goes, and moved over the hills: its height above the ground at every step.
HEIGHTS = f"""async () => {{ {IMPORTS} {VIEWER}
  const {{ stage }} = viewer, {{ orbit, camera }} = stage, gaps = [];
  const look = () => {{
    orbit.place();
    gaps.push(camera.position.z - orbit.floor(camera.position.x, camera.position.y),
              orbit.target.z - orbit.floor(orbit.target.x, orbit.target.y) + 0.5);
  }};
  for (let n = 0; n < 40; n++) {{ orbit.turn(0.3, -0.2); look(); }}
  for (let n = 0; n < 40; n++) {{ orbit.near(0.9); orbit.slide(0, 0.1); look(); }}
  for (let n = 0; n < 60; n++) {{ orbit.turn(0.2, 0); orbit.slide(0.3, 0.2); look(); }}
  return gaps; }}"""


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


def readout(page: Page) -> dict[str, str]:
    shown = page.locator(".viewer-readout")
    names, values = shown.locator("dt").all_text_contents(), shown.locator("dd").all_text_contents()
    return dict(zip(names, values, strict=True)) | {"class": shown.locator("h3").inner_text()}


def row_at(tile: TileVoxels, place: str, voxel_m: float = MAP_VOXEL_M) -> int:
    """The row of the voxel whose centre is next to this place of the map."""
    at = np.array([float(value) for value in place.removesuffix(" m").split(",")])
    return int(np.argmin(np.linalg.norm((tile.indices + 0.5) * voxel_m - at, axis=1)))


def expected(place: str) -> dict[str, str]:
    """What the tile holds at the voxel whose centre is next to this place of the map, in the readout's words."""
    tile = RUN.voxels
    row = row_at(tile, place)
    elevation, slope, rough = tile.features[row]
    d2 = tile.distance_squared[row]
    return {
        "Elevation": f"{elevation:.2f} m",
        "Slope": f"{np.degrees(slope):.1f}°",
        "Roughness": f"{1000 * np.exp(rough / 2):.0f} mm (log {rough:.1f})",
        "D²": f"{d2:.1f}",
        "Map position": place,
        "class": KINDS[int(tile.classes[row])],
    }


def test_frames_are_stepped_through_picked_in_and_shown_by_layers(at_viewer: Page, seen: dict[str, Any]) -> None:
    """One page, one world: each step goes on where the last one left the viewer."""
    step_by_keys(at_viewer, seen)
    picked_by_keys_is_picked_by_mouse(at_viewer)
    choose_layers(at_viewer)
    miss_a_frame(at_viewer, seen)


def step_by_keys(page: Page, seen: dict[str, Any]) -> None:
    """The address follows, but not while they play: browsers refuse more than a hundred changes in half a minute."""
    expect(host(page)).to_have_attribute("data-frame", "1")
    canvas(page).focus()
    page.keyboard.press(".")
    expect(host(page)).to_have_attribute("data-frame", "2")
    expect(page).to_have_url(f"/sequences/{seen['id']}/view?frame={seen['tokens'][2]}")
    page.keyboard.press("End")
    expect(host(page)).to_have_attribute("data-frame", "5")
    page.keyboard.press(",")
    expect(host(page)).to_have_attribute("data-frame", "4")
    page.get_by_label("Frame", exact=True).press("Home")
    expect(host(page)).to_have_attribute("data-frame", "0")
    page.evaluate(
        """() => { window.writes = 0; const replace = history.replaceState.bind(history);
          history.replaceState = (...given) => { window.writes += 1; replace(...given); }; }"""
    )
    canvas(page).press("Space")
    expect(host(page)).to_have_attribute("data-frame", "5")
    expect(page.get_by_role("button", name="Play")).to_be_visible()
    token = page.evaluate(TOKEN)
    until(lambda: page.evaluate("location.href").endswith(f"frame={token}"))
    assert 1 <= page.evaluate("window.writes") <= 5
    heights_m = page.evaluate(HEIGHTS)
    assert len(heights_m) == 280
    assert min(heights_m) >= 0.5 - 1e-6


def test_keys_work_wherever_the_focus_is_but_not_where_something_is_entered(at_viewer: Page) -> None:
    page = at_viewer
    stands = expect(host(page))
    assert page.evaluate("document.activeElement === document.body")
    page.keyboard.press(".")
    stands.to_have_attribute("data-frame", "2")
    page.get_by_role("button", name="From above").click()  # it has the focus now
    page.keyboard.press(".")
    stands.to_have_attribute("data-frame", "3")
    page.evaluate("document.querySelector('h1').append(document.createElement('input'))")
    page.locator("h1 input").focus()
    page.keyboard.type(",,1. ")
    assert page.locator("h1 input").input_value() == ",,1. "
    stands.to_have_attribute("data-frame", "3")
    page.get_by_label("Colour by").press("c")  # a letter chooses in a list
    page.get_by_text("Keys and mouse").click()
    page.get_by_label("Keys work on the whole page").uncheck()
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("2")
    page.keyboard.press(",")
    stands.to_have_attribute("data-frame", "3")
    canvas(page).press(",")
    stands.to_have_attribute("data-frame", "2")
    page.reload()
    page.get_by_text("Keys and mouse").click()
    expect(page.get_by_label("Keys work on the whole page")).not_to_be_checked()


def picked_by_keys_is_picked_by_mouse(page: Page) -> None:
    """And is said as the tile has it."""
    page.goto(page.url.partition("?")[0])
    expect(host(page)).to_have_attribute("data-state", "ready")
    canvas(page).focus()
    page.keyboard.press("c")
    page.keyboard.press("Shift+ArrowDown")
    expect(page.locator(".viewer-readout")).to_be_visible()
    until(lambda: readout(page) == readout(page) | expected(readout(page)["Map position"]))
    is_indexed(page, RUN, 0)
    by_keys = readout(page)
    page.keyboard.press("Escape")
    expect(page.locator(".viewer-readout")).to_be_hidden()
    box = canvas(page).bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2 + 40)
    expect(page.locator(".viewer-readout")).to_be_visible()
    assert readout(page) == by_keys


def is_indexed(page: Page, run: Run, frame: int) -> None:
    """The index is that of the labels' array: of the class, at the ego position, which is at the map position."""
    told, grid = readout(page), run.grid
    index = tuple(int(value) for value in told["Voxel of the frame"].strip("[]").split(","))
    assert told["class"] == KINDS[int(run.grids[frame][index])]
    ego = np.array([float(value) for value in told["Ego position"].removesuffix(" m").split(",")])
    assert ego == pytest.approx((np.array(index) + 0.5) * grid.voxel_m + grid.min_m, abs=0.051)
    assert SE3(run.poses[frame][[3, 4, 5, 6, 0, 1, 2]]) @ ego == pytest.approx(place_of(told), abs=0.101)


def choose_layers(page: Page) -> None:
    page.get_by_label("Show", exact=True).select_option("map")
    with page.expect_response(lambda answer: "/scene/meshes/0_0" in answer.url) as surface:
        page.get_by_label("Surface").check()
    with page.expect_response(lambda answer: "/cloud" in answer.url) as cloud:
        page.get_by_label("Point cloud").check()
    assert surface.value.ok
    assert cloud.value.ok
    page.get_by_label("Points by").select_option("time")
    until(lambda: page.evaluate(SWEEPS) == 1)
    for shown in (2, 3):
        canvas(page).press(".")
        until(lambda shown=shown: page.evaluate(SWEEPS) == shown)  # type: ignore[misc]
    page.get_by_label("Points by").select_option("intensity")
    until(lambda: page.evaluate(SWEEPS) == 1)
    expect(page.locator(".viewer-corner")).not_to_be_empty()


def miss_a_frame(page: Page, seen: dict[str, Any]) -> None:
    """A frame that does not come is said; the page and its viewer tell each other the frame."""
    page.route(f"**/frames/{seen['tokens'][-1]}/voxels?*", lambda route: route.fulfill(body=b"not zstd"))
    page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")  # it may have been fetched ahead
    expect(host(page)).to_have_attribute("data-state", "ready")
    told = page.evaluate(
        """() => new Promise(tell => {
            const host = document.querySelector("[data-viewer]");
            host.addEventListener("frame", ({ detail }) => tell(detail), { once: true });
            host.dispatchEvent(new CustomEvent("show-frame", { detail: { index: 3 } }));
        })"""
    )
    assert told == {"index": 3, "token": seen["tokens"][3]}
    page.get_by_label("Frame", exact=True).press("End")
    expect(page.locator(".viewer-said")).to_contain_text("Frame 6")


def test_confidence_is_a_colour_a_legend_and_a_row_of_the_readout(site: Site, curator: Person) -> None:
    run = Run(frames=2, reach_m=3.0, has_confidence=True)
    seen = viewed(site.platform, curator, run)
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}&show=map&colour=confidence")
        expect(host(page)).to_have_attribute("data-state", "ready")
        expect(page.get_by_label("Colour by")).to_have_value("confidence")
        expect(page.locator(".viewer-ticks span")).to_have_text(["50 % and less", "75 %", "100 %"])
        canvas(page).focus()
        page.keyboard.press("c")
        page.keyboard.press("Shift+ArrowDown")
        name = "Probability that this label is right"
        until(lambda: name in readout(page))
        told = readout(page)
        row = row_at(run.voxels, told["Map position"])
        confidence = round(run.voxels.confidence[row] / 2.55)
        assert told[name] == f"{confidence if run.voxels.classes[row] == 1 else min(99, confidence)} %"


def test_confidence_cannot_be_chosen_without_one(at_viewer: Page) -> None:
    at_viewer.goto(f"{at_viewer.url}&colour=confidence")
    expect(host(at_viewer)).to_have_attribute("data-state", "ready")
    colours = at_viewer.get_by_label("Colour by")
    expect(colours).to_have_value("class")
    assert colours.locator("option:disabled").evaluate_all("all => all.map(one => one.value)") == ["confidence"]
    expect(at_viewer.get_by_text("only labels of profile field have one")).to_be_visible()


def test_of_imported_labels_a_voxel_says_its_class_alone(site: Site, curator: Person) -> None:
    seen = viewed(site.platform, curator, Run(frames=2, reach_m=3.0, is_imported=True))
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(host(page)).to_have_attribute("data-state", "ready")
        canvas(page).focus()
        page.keyboard.press("c")
        page.keyboard.press("Shift+ArrowDown")
        expect(page.locator(".viewer-readout")).to_be_visible()
        until(lambda: set(readout(page)) == {"Voxel of the frame", "Ego position", "Map position", "class"})
        values = page.get_by_label("Colour by").locator("option").evaluate_all("all => all.map(one => one.value)")
        assert values == ["class"]


RELEASED = Run(frames=2, reach_m=14.0, grid=RELEASE)
BOUGHT = replace(RELEASED, voxel_m=0.4, is_imported=True)
GROUND_M = f"async given => {{ {IMPORTS} {VIEWER} return given.map(([x, y]) => viewer.world.height.at(x, y)); }}"
MARKED_M = f"async () => {{ {IMPORTS} {VIEWER} return viewer.world.marker.lines.scale.x; }}"


@pytest.mark.parametrize("run", [RELEASED, BOUGHT], ids=["labelled here", "imported"])
def test_a_frame_of_the_released_datasets_grid_is_picked_in_and_so_is_its_map(
    site: Site, curator: Person, run: Run
) -> None:
    seen = viewed(site.platform, curator, run, has_clouds=True)
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(host(page)).to_have_attribute("data-state", "ready")
        canvas(page).focus()
        page.keyboard.press("c")
        page.keyboard.press("Shift+ArrowDown")
        expect(page.locator(".viewer-readout")).to_be_visible()
        picked_in_frame(page, run)
        keep(page, f"viewer-release-{'imported' if run.is_imported else 'labelled'}")
        stands_on_the_ground(page, run)
        page.get_by_label("Point cloud").check()
        page.get_by_label("Points by").select_option("height")
        expect(page.locator(".viewer-ticks span")).to_have_text(["-1.0 m", "2.2 m", "5.4 m"])
        page.get_by_label("Point cloud").uncheck()
        page.get_by_label("Show", exact=True).select_option("map")
        before = readout(page)
        canvas(page).press("ArrowDown")
        until(lambda: page.evaluate(MARKED_M) == run.voxel_m and readout(page) != before)
        place = place_of(readout(page))
        row = row_at(run.voxels, readout(page)["Map position"], run.voxel_m)
        assert place == pytest.approx((run.voxels.indices[row] + 0.5) * run.voxel_m, abs=0.051)
        assert readout(page)["class"] == KINDS[int(run.voxels.classes[row])]
        pose = SE3(run.poses[1][[3, 4, 5, 6, 0, 1, 2]])
        at = (pose.inverse() @ place - run.grid.min_m) / run.grid.voxel_m
        index = [int(value) for value in readout(page)["Voxel of the frame"].strip("[]").split(",")]
        assert at == pytest.approx(np.array(index) + 0.5, abs=0.65)  # of voxels: positions are to a decimetre


def picked_in_frame(page: Page, run: Run) -> None:
    """The voxel is one of the frame's grid, of the class there; its values are of a voxel of the map in it."""
    is_indexed(page, run, 1)
    told, pose = readout(page), SE3(run.poses[1][[3, 4, 5, 6, 0, 1, 2]])
    at = (pose.inverse() @ place_of(told) - run.grid.min_m) / run.grid.voxel_m
    index = np.floor(at).astype(int)
    assert at == pytest.approx(index + 0.5, abs=0.2)  # of voxels: positions are to a decimetre
    kind = run.grids[1][tuple(index)]
    assert told["class"] == KINDS[int(kind)]
    assert page.evaluate(MARKED_M) == run.grid.voxel_m == 0.4
    tile = run.voxels
    centres = (pose.inverse() @ ((tile.indices + 0.5) * run.voxel_m) - run.grid.min_m) / run.grid.voxel_m
    is_in = (np.abs(centres - index - 0.5) <= 0.61).all(axis=1) & (tile.classes == kind)
    slopes = {f"{np.degrees(slope):.1f}°" for slope in tile.features[is_in, 1]}
    assert run.is_imported or told["Slope"] in slopes


def stands_on_the_ground(page: Page, run: Run) -> None:
    """The camera's floor is the lowest label of squares of 0.8 m; from above it sees the whole grid."""
    pose = SE3(run.poses[1][[3, 4, 5, 6, 0, 1, 2]])
    around = np.random.default_rng(2).uniform(-8, 8, (20, 2))
    around_map = pose @ np.column_stack([around, np.zeros(20)])
    low_m = run.grid.min_m
    squares = run.grids[1].reshape(100, 2, 100, 2, 16).any(axis=(1, 3))
    lowest = [squares[tuple(np.floor((place - low_m[:2]) / 0.8).astype(int))].argmax() for place in around]
    wanted_m = np.array(lowest) * 0.4 + low_m[2] + pose.translation_m[2]
    assert page.evaluate(GROUND_M, around_map[:, :2].tolist()) == pytest.approx(wanted_m)
    canvas(page).press("2")
    assert page.evaluate(VIEW)[2:5] == pytest.approx([80 * 62 / 51.2, 0, 0], abs=1e-6)
    canvas(page).press("1")


def place_of(told: dict[str, str]) -> Any:
    return np.array([float(value) for value in told["Map position"].removesuffix(" m").split(",")])


def test_without_webgl_frames_are_shown_from_above_and_without_a_scene_nothing_is(
    site: Site, curator: Person, seen: dict[str, Any]
) -> None:
    with site.visit(curator, expected=["404"]) as page:
        page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
        page.goto(f"/sequences/{seen['id']}/view")
        expect(host(page)).to_have_attribute("data-state", "picture")
        page.get_by_role("button", name="Next frame").click()
        expect(page.get_by_role("img", name="frame 2 of 6")).to_be_visible()
        with site.platform.database.transaction() as session:
            session.execute(delete(Artefact).where(Artefact.name == "scene/scene.json"))
        page.reload()
        expect(host(page)).to_have_attribute("data-state", "empty")


def chosen(page: Page) -> dict[str, Any]:
    """What the panel says, and where the camera stands."""
    selects = page.locator(".viewer-panel select").evaluate_all("all => all.map(one => one.value)")
    checks = page.locator(".viewer-panel input").evaluate_all("all => all.map(one => [one.checked, one.value])")
    view, frame = page.evaluate(VIEW), host(page).get_attribute("data-frame")
    return {"selects": selects, "checks": checks, "view": view, "frame": frame}


def says_where_it_stands(page: Page) -> bool:
    """Whether the address, which is written a while after the last change, has come to the camera's view."""
    said = parse_qs(urlsplit(page.evaluate("location.href")).query).get("at", [""])[0]
    return bool(said) and [float(value) for value in said.split(",")] == pytest.approx(page.evaluate(VIEW), rel=1e-3)


def test_an_address_that_is_copied_shows_the_same_frame_layers_colours_and_view(
    site: Site, curator: Person, at_viewer: Page, seen: dict[str, Any]
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
    fill(page, "Heights shown, metres above the ground under the robot, to", "1.5")
    fill(page, "Colours of points, from", "-0.5")
    page.get_by_label("Point size").fill("2.5")
    canvas(page).focus()
    for key in ("f", "Shift+ArrowLeft", "ArrowUp", "d", "+", "."):  # the robot leaves the camera behind
        page.keyboard.press(key)
    expect(host(page)).to_have_attribute("data-frame", "2")
    parts = ("colour=slope", "hide=n", "points=height", "follow=off", "heights=,1.5", "range=-0.5,", "size=2.5")
    until(lambda: says_where_it_stands(page) and all(part in page.evaluate("location.href") for part in parts))
    before, address = chosen(page), page.evaluate("location.href")
    with site.visit(curator) as other:
        other.goto(address)
        expect(host(other)).to_have_attribute("data-state", "ready")
        expect(host(other)).to_have_attribute("data-frame", "2")
        after = chosen(other)
        assert {**after, "view": None} == {**before, "view": None}
        assert after["view"] == pytest.approx(before["view"], rel=2e-3, abs=2e-3)
        other.wait_for_timeout(600)
        assert other.evaluate("location.href") == address
        layers = "layers=lasers,labels,track,robot,grid"
        nonsense = f"colour=mauve&show=everything&hide=x&{layers}&cameras=7&at=1,2,x&points=q&camera=CAM_MOON"
        nonsense += "&heights=3,1&range=x&size=9"
        plain = f"/sequences/{seen['id']}/view?frame={seen['tokens'][0]}"
        other.goto(f"{plain}&{nonsense}")
        expect(host(other)).to_have_attribute("data-frame", "0")
        expect(other).to_have_url(plain)


def fill(page: Page, label: str, value: str) -> None:
    field = page.get_by_label(label, exact=True)
    field.fill(value)
    field.blur()


SECOND = f"""async () => {{ {IMPORTS} {VIEWER}
  const {{ second }} = viewer.world;
  if (!second?.group.visible) return null;
  const drawn = second.mesh.geometry.getIndex().array.length / 6;
  return [drawn, second.material.uniforms.hatch.value, second.material.polygonOffset]; }}"""
QUADS = f"""async given => {{ {IMPORTS}
  const {{ Solid }} = await load("data/solid"), {{ facesOf }} = await load("data/faces");
  const solid = new Solid(PAPER.shape);
  for (const [i, j, k, colour] of given) solid.paint(i, j, k, colour);
  return facesOf(solid).quads; }}"""


def second_over_the_first(page: Page, grid: Grid) -> None:
    """The label set that counts no more is drawn over the one that does; not where it would be of something else."""
    page.get_by_label("Show", exact=True).select_option("frame")
    assert page.evaluate(SECOND) is None
    page.get_by_label("Voxels not observed").select_option("show")
    others = page.get_by_label("Second label set")
    expect(others.locator("option")).to_have_count(2)
    others.select_option(index=1)
    voxels = [[*map(int, at), int(grid[tuple(at)])] for at in np.argwhere(grid)]
    wanted = [page.evaluate(QUADS, voxels), pytest.approx(0.6), True]
    until(lambda: page.evaluate(SECOND) == wanted)
    expect(page.get_by_text("Hatched: ")).to_be_visible()
    keep(page, "viewer-second")
    until(lambda: "second=" in page.evaluate("location.href"))
    page.goto(page.evaluate("location.href"))
    expect(host(page)).to_have_attribute("data-state", "ready")
    until(lambda: page.evaluate(SECOND) == wanted)
    page.get_by_label("Show", exact=True).select_option("map")
    until(lambda: page.evaluate(SECOND) is None)


def changed(grid: Grid) -> Grid:
    """Of every class a part is free, and a part of another class; something stands where nothing was."""
    other = np.where(np.random.default_rng(5).random(grid.shape) < 0.3, grid % 3 + 1, grid).astype(np.uint8)
    other[grid == 0] = 0
    other[:, :120] = 0
    other[100:104, 126:130, 20:22] = 3
    return other


def legend(page: Page) -> list[str]:
    return [row.locator(".viewer-share").inner_text() for row in page.locator(".viewer-legend li").all()]


def test_the_difference_of_two_label_sets_is_shown_with_its_shares_to_who_may_compare(
    site: Site, curator: Person
) -> None:
    facts = viewed(site.platform, curator, SHORT)
    b, a = SHORT.grids[0], changed(SHORT.grids[0])
    earlier = made.labels(site.platform, facts, contents=[labels_npz(a)] * 2, seed=b"earlier")
    comparison_id = made.label_comparison(site.platform, facts["id"], (earlier.id, facts["label_set_id"]))
    plain = f"/sequences/{facts['id']}/view?frame={facts['tokens'][0]}"
    with site.platform.database.transaction() as session:
        session.get_one(SequenceRow, facts["id"]).is_public = True
    with site.visit(curator) as page:
        page.goto(f"{plain}&compare={comparison_id}")
        expect(host(page)).to_have_attribute("data-state", "ready")
        colour = page.get_by_label("Colour by")
        expect(colour).to_have_value("difference")
        codes = differences(a, b)
        counts = np.bincount(codes[codes > 0], minlength=len(DIFFERENCES))[1:]
        until(lambda: legend(page) == [f"{round(100 * count / counts.sum())} %" for count in counts])
        until(lambda: page.evaluate(FIRST_COLOUR) == list(DIFFERENCE_RGB[SAME]))
        colour.select_option("class")
        until(lambda: page.evaluate(FIRST_COLOUR) == list(CLASS_RGB[1]))
        page.get_by_label("Class colours").select_option("paper")
        until(lambda: page.evaluate(FIRST_COLOUR) == list(PALETTES["paper"][1]))
        colour.select_option("difference")
        page.get_by_label("Show", exact=True).select_option("map")
        expect(colour).to_have_value("class")
        second_over_the_first(page, b)
    with site.visit() as page:
        page.goto(f"{plain}&second={facts['label_set_id']}")
        expect(page.get_by_label("Second label set")).to_have_count(0)
        expect(host(page)).to_have_attribute("data-state", "ready")
        values = page.get_by_label("Colour by").locator("option").evaluate_all("all => all.map(o => o.value)")
        assert "difference" not in values
