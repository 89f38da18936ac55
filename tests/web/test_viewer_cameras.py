"""The cameras beside the 3D view: what they see of the labels, held to numpy; pictures and 3D move together."""

from collections.abc import Iterator
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Locator, Page, Route, expect

from services.domain.viewer.playback import INDEX, PlaybackChannels, index_record
from services.runtime.platform import Platform
from stone.geometry.se3 import SE3
from stone.sensors.projection import project, rays_through
from stone_base.label_grid import RELEASE
from testing.api.serving import Person
from testing.stone_serve import until
from testing.web.browsing import DESKTOP, PHONE, Site
from testing.worlds.viewer_cameras import CHANNELS, camera_files, lens_of, played, shutter_pose
from testing.worlds.viewer_world import BLOCK_M, SENSORS, Run, viewed
from tests.web.looking import keep, look
from tests.web.test_viewer import VIEWER, canvas, host, readout
from tests.web.test_viewer_data import IMPORTS

RUN, RELEASED = Run(frames=6, reach_m=4.5), Run(frames=2, reach_m=6.0, grid=RELEASE)
# Where the top of the marked voxel is in the 3D view, as shares of its size; it fails where none is marked.
MARKED_IN_3D = f"""async () => {{ {IMPORTS} {VIEWER}
  const {{ marker }} = viewer.world, {{ camera, orbit }} = viewer.stage;
  if (!marker.lines.visible) throw new Error("no voxel is marked in 3D");
  const place = marker.lines.position.clone();
  place.z += 0.099;
  orbit.place();
  camera.updateMatrixWorld();
  place.project(camera);
  return [(place.x + 1) / 2, (1 - place.y) / 2]; }}"""


@pytest.fixture
def seen(site: Site, curator: Person, request: pytest.FixtureRequest) -> dict[str, Any]:
    run = getattr(request, "param", RUN)
    return viewed(site.platform, curator, run, has_cameras=True) | {"run": run}


@pytest.fixture
def at_viewer(site: Site, curator: Person, seen: dict[str, Any]) -> Iterator[Page]:
    with site.visit(curator) as page:
        page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")
        expect(strip(page)).to_have_attribute("data-frame", "1")
        yield page


def strip(page: Page) -> Locator:
    return page.locator(".viewer-cameras")


def picture(page: Page, name: str) -> Locator:
    return page.locator(".viewer-camera-row").get_by_role("button", name=f"{name} camera")


def press(page: Page, name: str) -> None:
    """Click in a camera's picture where the ground is."""
    box = picture(page, name).bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 0.55 * box["width"], box["y"] + 0.8 * box["height"])


def views(page: Page, token: str, size: tuple[int, int]) -> list[Any]:
    """The ids (rows, columns) that each camera sees of a frame, by the page's worker."""
    script = f"""async given => {{ {IMPORTS} {VIEWER}
      const sizes = given.cameras.map(camera => ({{ camera, width: given.width, height: given.height }}));
      const look = {{ mode: "class", classes: 14, unseen: "fade" }};
      const views = await viewer.world.asking.ask({{ kind: "camera-views", token: given.token, look, sizes }});
      return views.map(view => Array.from(view.ids)); }}"""
    given = {"cameras": list(range(len(CHANNELS))), "width": size[0], "height": size[1], "token": token}
    return [np.array(ids).reshape(size[1], size[0]) for ids in page.evaluate(script, given)]


SENSED = f"""async () => {{ {IMPORTS} {VIEWER}
  const {{ sensors }} = viewer.world, listed = lines => [...lines.geometry.getAttribute("position").array];
  return {{ axes: listed(sensors.axes), edges: listed(sensors.edges), matrix: sensors.group.matrix.elements,
    names: [...sensors.names.children].map(one => one.textContent),
    boxes: [...sensors.names.children].filter(one => !one.hidden).map(one => one.getBoundingClientRect()),
    origin: viewer.world.origin }}; }}"""


def test_sensors_stand_where_they_are_mounted_and_cameras_where_they_were_at_the_shutter(
    at_viewer: Page, seen: dict[str, Any]
) -> None:
    """Axes of 0.35 m from each sensor's place; of each camera lines to the corners of its picture, by numpy."""
    page = at_viewer
    page.get_by_label("Sensors and camera views").check()
    until(lambda: page.evaluate("document.querySelectorAll('.viewer-names > span').length") == 8)
    told = page.evaluate(SENSED)
    placed = [SE3(np.array([*one.ego_from_sensor[3:], *one.ego_from_sensor[:3]])) for one in SENSORS]
    placed += [shutter_pose(channel) for channel in CHANNELS]
    axes = np.array(told["axes"]).reshape(-1, 3, 2, 3)
    for pose, drawn in zip(placed, axes, strict=True):
        np.testing.assert_allclose(drawn[:, 0], np.tile(pose.translation_m, (3, 1)), atol=1e-6)
        np.testing.assert_allclose(drawn[:, 1], pose @ (0.35 * np.eye(3)), atol=1e-6)
    edges = np.array(told["edges"]).reshape(len(CHANNELS), -1, 2, 3)
    for channel, drawn in zip(CHANNELS, edges, strict=True):
        lens, pose = lens_of(channel), shutter_pose(channel)
        right, low = lens.width_px - 0.5, lens.height_px - 0.5
        corners = np.array([(-0.5, -0.5), (right, -0.5), (right, low), (-0.5, low)])
        np.testing.assert_allclose(drawn[-4:, 0], np.tile(pose.translation_m, (4, 1)), atol=1e-5)
        np.testing.assert_allclose(drawn[-4:, 1], pose @ (1.2 * rays_through(corners, lens)), atol=1e-5)
        np.testing.assert_array_equal(drawn[:-4, 1], np.roll(drawn[:-4, 0], -1, axis=0))  # a closed line
    wanted = SE3(RUN.poses[1][[3, 4, 5, 6, 0, 1, 2]]).as_matrix()
    wanted[:3, 3] -= told["origin"]
    np.testing.assert_allclose(np.array(told["matrix"]).reshape(4, 4).T, wanted, atol=1e-9)
    assert set(told["names"]) == {*CHANNELS, "LIDAR_TOP", "RADAR_LEFT"}
    page.locator(".viewer-canvas").hover()
    for _ in range(6):
        page.mouse.wheel(0, -600)
        page.wait_for_timeout(100)
    until(lambda: len(page.evaluate(SENSED)["boxes"]) > len(told["boxes"]))  # nearer, more of them stand apart
    for one, other in combinations(page.evaluate(SENSED)["boxes"], 2):
        is_beside = one["right"] <= other["left"] or other["right"] <= one["left"]
        assert is_beside or one["bottom"] <= other["top"] or other["bottom"] <= one["top"], (one, other)
    look(page, "viewer-sensors")
    page.get_by_label("Sensors and camera views").uncheck()
    expect(page.locator(".viewer-names")).to_be_hidden()
    page.goto(f"{page.url.partition('?')[0]}?layers=labels,sensors")  # frusta come once cameras are known
    until(lambda: page.evaluate("document.querySelectorAll('.viewer-names > span').length") == 8)


def voxels_of(run: Run, ids: Any) -> Any:
    """(N, 3) indices of the voxels with these ids."""
    return np.stack(np.unravel_index(ids - 1, run.grid.shape), axis=-1)


def corners_of(run: Run, voxels: Any) -> Any:
    """(N, 8, 3) of voxels (N, 3) in the ego frame."""
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    return (voxels[:, None] + corners) * run.grid.voxel_m + run.grid.min_m


@pytest.mark.parametrize(
    ("seen", "reach"),
    [pytest.param(RUN, 25, id="paper"), pytest.param(RELEASED, 40, id="release", marks=pytest.mark.release)],
    indirect=["seen"],
)
def test_every_pixel_with_a_label_is_of_the_first_voxel_that_its_ray_meets(
    at_viewer: Page, seen: dict[str, Any], reach: int
) -> None:
    """Catches alone a pixel off by a half, a quaternion transposed, the frame's pose in the place of the shutter's."""
    token, run = seen["tokens"][1], seen["run"]
    expect(at_viewer.get_by_text(f"Labels are drawn up to {reach} m from the robot")).to_be_visible()
    large, small = views(at_viewer, token, (320, 200)), views(at_viewer, token, (64, 40))
    for place, channel in enumerate(CHANNELS):
        are_within(run, channel, large[place])
        are_first(run, channel, small[place])
    block_hides(run, large)


def are_within(run: Run, channel: str, ids: Any) -> None:
    """Every pixel is where numpy projects its voxel."""
    rows, columns = np.nonzero(ids)
    assert len(rows) > 3000, channel
    voxels = voxels_of(run, ids[rows, columns])
    assert (run.grids[1][tuple(voxels.T)] > 0).all()
    lens = lens_of(channel)
    camera_from_ego = shutter_pose(channel).inverse()
    corners = (camera_from_ego @ corners_of(run, voxels).reshape(-1, 3)).reshape(-1, 8, 3)
    whole = (corners[..., 2] > 0.05).all(axis=1)
    pixels = np.stack([project(corners[whole, corner], lens)[0] for corner in range(8)], axis=1)
    pixels = (pixels + 0.5) * (320 / lens.width_px)
    at = np.stack([columns[whole] + 0.5, rows[whole] + 0.5], axis=1)
    low, high = pixels.min(axis=1) - 0.25, pixels.max(axis=1) + 0.25
    is_inside = ((at >= low) & (at <= high)).all(axis=1)
    assert is_inside.mean() == 1.0, f"{(~is_inside).sum()} of {len(at)} pixels are outside their voxel"


def are_first(run: Run, channel: str, ids: Any) -> None:
    """What a pixel shows is the voxel that small steps along its ray meet first."""
    random = np.random.default_rng(3)
    pose, lens = shutter_pose(channel), lens_of(channel)
    rows, columns = random.integers(0, 40, 60), random.integers(0, 64, 60)
    scale = lens.width_px / 64
    pixels = np.stack([(columns + 0.5) * scale - 0.5, (rows + 0.5) * scale - 0.5], axis=1)
    rays = SE3(np.array([*pose.wxyz_xyz[:4], 0, 0, 0])) @ rays_through(pixels, lens)
    same = sum(
        _stepped(run, pose.translation_m, ray) == ids[row, column]
        for ray, row, column in zip(rays, rows, columns, strict=True)
    )
    assert same >= 58, f"{channel}: {same} of 60"  # a ray through an edge may meet either


def _stepped(run: Run, start_m: Any, ray: Any) -> int:
    """1 + index of the first labelled voxel along the ray, by steps of a millimetre."""
    places_m, grid = np.arange(0.1, 40, 0.001)[:, None] * ray + start_m, run.grid
    steps = np.floor((places_m - grid.min_m) / grid.voxel_m).astype(int)
    steps = steps[((steps >= 0) & (steps < grid.shape)).all(axis=1)]
    met = np.flatnonzero(run.grids[1][tuple(steps.T)])
    return int(np.ravel_multi_index(tuple(steps[met[0]]), grid.shape)) + 1 if len(met) else 0


def block_hides(run: Run, ids: list[Any]) -> None:
    """Where the block stands it is seen, and not the ground behind it."""
    x0, y0, x1, y1, high_m = BLOCK_M
    pose = SE3(run.poses[1][[3, 4, 5, 6, 0, 1, 2]])
    block = pose.inverse() @ np.array([(x0 + x1) / 2, (y0 + y1) / 2, high_m / 2])
    hits = 0
    for place, channel in enumerate(CHANNELS):
        camera_from_ego = shutter_pose(channel).inverse()
        pixels, is_in = project((camera_from_ego @ block)[None], lens_of(channel))
        if not is_in[0]:
            continue
        column, row = ((pixels[0] + 0.5) / 2).astype(int)
        met = corners_of(run, voxels_of(run, ids[place][row, column][None]))[0, 0]
        assert np.hypot(*(met[:2] - block[:2])) < 1.5, "the block, not the ground behind it"
        hits += 1
    assert hits


def test_pictures_and_3d_explain_the_same_voxel_and_are_enlarged_switched_off_and_left_plain(at_viewer: Page) -> None:
    """One page, one world: each step goes on where the last one left the viewer."""
    explain_from_both(at_viewer)
    enlarge_by_keys(at_viewer)
    leave_plain(at_viewer)
    switch_classes_off(at_viewer)


def explain_from_both(page: Page) -> None:
    """A voxel chosen in a picture is marked in 3D and in the pictures; chosen in 3D it is the same one."""
    press(page, "Front")
    expect(page.locator(".viewer-readout")).to_be_visible()
    by_picture = readout(page)
    assert set(by_picture) == {
        "Elevation",
        "Slope",
        "Roughness",
        "D²",
        "Voxel of the frame",
        "Ego position",
        "Map position",
        "class",
    }
    marked = page.locator(".viewer-camera-row canvas[data-marked]:not([data-marked='0'])")
    expect(marked.first).to_be_visible()
    across, down = page.evaluate(MARKED_IN_3D)
    canvas(page).press("Escape")
    expect(page.locator(".viewer-readout")).to_be_hidden()
    expect(marked).to_have_count(0)
    box = canvas(page).bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])
    expect(page.locator(".viewer-readout")).to_be_visible()
    assert readout(page) == by_picture
    expect(marked.first).to_be_visible()
    canvas(page).press("Escape")


def enlarge_by_keys(page: Page) -> None:
    picture(page, "Front left").focus()
    page.keyboard.press("Enter")
    large = page.get_by_role("region", name="Camera picture, large")
    expect(large.locator("canvas")).to_have_attribute("width", "640")
    expect(large.get_by_role("button", name="Close")).to_be_focused()
    both_are_seen(page, large)
    page.keyboard.press("Escape")
    expect(large).to_be_hidden()
    expect(picture(page, "Front left")).to_be_focused()


def both_are_seen(page: Page, large: Locator) -> None:
    """The picture covers nothing of the 3D view: it stands to the right of it, on a phone below."""
    until(lambda: page.evaluate("[...document.images].every(one => one.complete)"))
    scene, beside = canvas(page).bounding_box(), large.bounding_box()
    assert scene is not None
    assert beside is not None
    assert scene["x"] + scene["width"] <= beside["x"] + 1
    assert min(scene["width"], beside["width"]) > 350
    assert beside["y"] == pytest.approx(scene["y"], abs=1)
    keep(page, "viewer-enlarged")
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    scene, beside = canvas(page).bounding_box(), large.bounding_box()
    assert scene is not None
    assert beside is not None
    assert scene["y"] + scene["height"] <= beside["y"] + 1
    assert scene["width"] == pytest.approx(beside["width"], abs=2)
    page.set_viewport_size(DESKTOP)  # type: ignore[arg-type]


def leave_plain(page: Page) -> None:
    """Without labels, or not shown at all."""
    names = page.locator(".viewer-camera-row figcaption > span").all_inner_texts()
    assert names == ["Front left", "Front", "Front right", "Back left", "Back", "Back right"], "as on the rig"
    page.get_by_label("Cameras").select_option("plain")
    expect(page.locator(".viewer-camera-row canvas:visible")).to_have_count(0)
    expect(page.locator(".viewer-camera-row img")).to_have_count(6)
    press(page, "Front")
    expect(page.locator(".viewer-said")).to_contain_text("No labels are drawn in this picture")
    canvas(page).press("v")
    expect(strip(page)).to_be_hidden()
    canvas(page).press("v")
    expect(page.locator(".viewer-camera-row canvas:visible")).to_have_count(6)


def switch_classes_off(page: Page) -> None:
    """What is switched off still hides, and says so."""
    page.get_by_label("Non-traversable").uncheck()
    page.get_by_label("Potentially").uncheck()
    page.get_by_label("Traversable", exact=True).uncheck()
    painted = "canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(v => v)"
    front = picture(page, "Front").locator("canvas").first
    until(lambda: not front.evaluate(painted))
    box = picture(page, "Front").bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + box["height"] * 0.8)
    expect(page.locator(".viewer-said")).to_contain_text("Switched off: ")
    page.mouse.click(box["x"] + box["width"] / 2, box["y"] + 3)
    expect(page.locator(".viewer-said")).to_contain_text("No label there")


def test_pictures_labels_and_slider_change_together_unless_a_picture_takes_too_long(
    at_viewer: Page, seen: dict[str, Any]
) -> None:
    """One picture of the next frame is late: nothing of that frame is shown before it."""
    late: list[Route] = []
    at_viewer.route(f"**/frames/{seen['tokens'][4]}/camera/CAM_BACK.jpg*", lambda route: late.append(route))
    slider = at_viewer.get_by_label("Frame", exact=True)
    at_viewer.evaluate(
        """() => { window.told = []; const host = document.querySelector("[data-viewer]");
          const strip = host.querySelector(".viewer-cameras");
          new MutationObserver(() => window.told.push([host.dataset.frame, strip.dataset.frame]))
            .observe(host, { attributes: true, attributeFilter: ["data-frame"], subtree: true }); }"""
    )
    with at_viewer.expect_request("**/camera/CAM_BACK.jpg*"):
        slider.fill("4")
    at_viewer.wait_for_timeout(300)
    assert strip(at_viewer).get_attribute("data-frame") == "1"
    assert host(at_viewer).get_attribute("data-frame") == "1"
    late[0].continue_()
    expect(strip(at_viewer)).to_have_attribute("data-frame", "4")
    expect(host(at_viewer)).to_have_attribute("data-frame", "4")
    sources = at_viewer.locator(".viewer-camera-row img").evaluate_all("all => all.map(one => one.src)")
    assert len(sources) == 6
    assert all(seen["tokens"][4] in source for source in sources)
    assert at_viewer.evaluate("window.told")[-1] == ["4", "4"]
    too_long(at_viewer, seen)


def too_long(page: Page, seen: dict[str, Any]) -> None:
    """The frame is shown without its picture, and nothing is picked in those of the frame before."""
    late: list[Route] = []
    page.route(f"**/frames/{seen['tokens'][5]}/camera/CAM_BACK.jpg*", lambda route: late.append(route))
    page.goto(f"/sequences/{seen['id']}/view?frame={seen['tokens'][1]}")  # it may have been fetched ahead
    expect(strip(page)).to_have_attribute("data-frame", "1")
    page.get_by_label("Frame", exact=True).press("End")
    expect(host(page)).to_have_attribute("data-frame", "5")
    expect(strip(page)).to_have_attribute("aria-busy", "true")
    press(page, "Front")
    expect(page.locator(".viewer-said")).to_have_text("The pictures of this frame are still loading.")
    expect(page.locator(".viewer-readout")).to_be_hidden()
    late[0].continue_()
    expect(strip(page)).to_have_attribute("data-frame", "5")
    expect(strip(page)).not_to_have_attribute("aria-busy", "true")


def test_a_playback_that_lacks_a_picture_or_labels_is_shown_as_far_as_it_goes(
    site: Site, curator: Person, platform: Platform
) -> None:
    """One picture is missing; pictures of an earlier release have no cameras; and there may be none at all."""
    lacking, plain, bare = (viewed(platform, curator, RUN, name=name) for name in ("lacking", "plain", "bare"))
    files = camera_files(lacking["tokens"], without=("CAM_BACK", 2))
    pictures = {name: content for name, content in camera_files(plain["tokens"]).items() if name.endswith(".jpg")}
    for one, content, has_cameras in ((lacking, files, True), (plain, pictures, False)):
        index = index_record(PlaybackChannels(tuple(CHANNELS), False, has_cameras))
        played(platform, curator, one["id"], {**content, INDEX: index})
    with site.visit(curator, expected=["409"]) as page:
        page.goto(f"/sequences/{lacking['id']}/view?frame={lacking['tokens'][2]}")
        expect(strip(page)).to_have_attribute("data-frame", "2")
        expect(picture(page, "Back").last).to_contain_text("No picture of this frame")
        page.goto(f"/sequences/{plain['id']}/view")
        expect(strip(page)).to_have_attribute("data-frame", "0")
        expect(page.locator(".viewer-camera-row img")).to_have_count(6)
        expect(page.locator(".viewer-camera-row canvas:visible")).to_have_count(0)
        page.goto(f"/sequences/{bare['id']}/view")
        expect(host(page)).to_have_attribute("data-state", "ready")
        expect(page.get_by_label("Cameras")).to_be_disabled()
        page.get_by_role("button", name="Prepare camera pictures").click()
        expect(strip(page)).to_contain_text("cannot be prepared")  # its recording was never brought
