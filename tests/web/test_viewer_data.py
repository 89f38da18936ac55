"""What the viewer makes of the bytes of the scene's routes, beside the arrays they were made of.

**Conventions.** The built modules run in the browser on what the real routes answer; what comes back is compared with
NumPy. Faces are compared with the slow definition: a face is seen where the voxel beside it is empty.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page

from testing.api.serving import Person
from testing.web.browsing import Site
from testing.worlds.viewer_world import SHAPE, Grid, Run, observed_of, viewed

RUN = Run(frames=2, reach_m=3.0)
IMPORTS = """
const base = document.querySelector('script[src*="modules/app.js"]').src.replace("app.js", "viewer/");
const load = name => import(base + name + ".js");
const fetched = async path => {
  const { decompress } = await import(base + "../../libraries/fzstd/esm/index.mjs");
  return decompress(new Uint8Array(await (await fetch(path)).arrayBuffer()));
};
"""


@pytest.fixture
def seen(site: Site, curator: Person) -> dict[str, Any]:
    return viewed(site.platform, curator, RUN)


@pytest.fixture
def loaded(site: Site, curator: Person) -> Iterator[Page]:
    """A page that may import the viewer's modules."""
    with site.visit(curator) as page:
        page.goto("/sign-in", wait_until="domcontentloaded")
        yield page


def run(page: Page, script: str, given: object = None) -> Any:
    return page.evaluate(f"async given => {{ {IMPORTS} {script} }}", given)


def test_a_frame_decodes_to_the_classes_and_the_mask_it_was_packed_of(loaded: Page, seen: dict[str, Any]) -> None:
    script = """
    const { planesOf, labelled, classAt, isObserved } = await load("data/formats");
    const planes = planesOf(await fetched(`/api/v1/frames/${given}/voxels`));
    const indices = [...labelled(planes)];
    return indices.map(index => [index, classAt(planes, index), Number(isObserved(planes, index))]);
    """
    grid = RUN.grids[1]
    flat = grid.ravel()
    at = np.flatnonzero(flat)
    wanted = np.stack([at, flat[at], observed_of(grid).ravel()[at]], axis=1)
    np.testing.assert_array_equal(run(loaded, script, seen["tokens"][1]), wanted)


def test_a_tile_decodes_to_the_voxels_it_was_made_of(loaded: Page, seen: dict[str, Any]) -> None:
    script = """
    const { tileOf } = await load("data/formats");
    const tile = tileOf(await fetched(`/api/v1/sequences/${given}/scene/tiles/0_0`));
    return Object.fromEntries(Object.entries(tile).map(([name, values]) => [name, [...values]]));
    """
    tile, voxels = run(loaded, script, seen["id"]), RUN.voxels
    np.testing.assert_array_equal(np.stack([tile["i"], tile["j"], tile["k"]], axis=1), voxels.indices)
    np.testing.assert_array_equal(tile["classes"], voxels.classes)
    features = np.stack([tile["elevation_m"], tile["slope_rad"], tile["roughness"]], axis=1)
    np.testing.assert_allclose(features, voxels.features, rtol=1e-6)
    np.testing.assert_allclose(tile["d2"], voxels.distance_squared, rtol=1e-6)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([83, 84, 86, 50, 3, 0, 0, 0], "begins with"),
        ([83, 84, 86, 49, 9, 0, 0, 0], "9 planes"),
        ([83, 84, 86, 49, 3, 0, 0, 0, 1], "ends before"),
        ([83, 84, 86, 49], "ends before"),
    ],
)
def test_what_is_not_a_frame_is_refused_in_words(loaded: Page, content: list[int], words: str) -> None:
    script = """
    const { planesOf } = await load("data/formats");
    try { planesOf(new Uint8Array(given)); return ""; } catch (error) { return error.message; }
    """
    assert words in run(loaded, script, content)


def test_merged_faces_cover_exactly_the_faces_whose_neighbour_is_empty(loaded: Page) -> None:
    script = """
    const { Solid } = await load("data/solid"), { facesOf } = await load("data/faces");
    const solid = new Solid(given.size);
    for (const [i, j, k, colour] of given.voxels) solid.paint(i, j, k, colour);
    const { vertices, quads } = facesOf(solid);
    return { vertices: [...vertices], quads };
    """
    random = np.random.default_rng(3)
    grid = np.zeros((9, 8, 7), np.uint8)
    grid[1:8, 1:7, 2] = 2
    grid[random.random(grid.shape) < 0.15] = 1
    voxels = [[*map(int, at), int(grid[tuple(at)])] for at in np.argwhere(grid)]
    made = run(loaded, script, {"size": list(grid.shape), "voxels": voxels})
    covered = _covered(np.array(made["vertices"]).reshape(-1, 4, 4))
    assert sorted(covered) == sorted(_exposed(grid))
    assert made["quads"] < len(covered)


def _exposed(grid: Grid) -> Iterator[tuple[int, ...]]:
    """(direction, colour, i, j, k) of every seen face, by definition."""
    padded = np.pad(grid, 1)
    for i, j, k in np.argwhere(grid):
        for direction in range(6):
            beside = np.array([i, j, k]) + 1
            beside[direction // 2] += -1 if direction % 2 else 1
            if padded[tuple(beside)] == 0:
                yield direction, int(grid[i, j, k]), int(i), int(j), int(k)


def _covered(quads: np.ndarray[Any, Any]) -> list[tuple[int, ...]]:
    """The same of quads (Q, 4, 4)."""
    faces: list[tuple[int, ...]] = []
    for corners in quads:
        word = int(corners[0, 3])
        direction, colour = (word >> 8) & 7, word & 255
        axis, low, high = direction // 2, corners[:, :3].min(axis=0), corners[:, :3].max(axis=0)
        low[axis] -= 0 if direction % 2 else 1
        high[axis] = low[axis] + 1
        spans = [range(int(a), int(b)) for a, b in zip(low, high, strict=True)]
        faces += [(direction, colour, i, j, k) for i in spans[0] for j in spans[1] for k in spans[2]]
    return faces


def test_a_ray_meets_the_voxel_that_small_steps_along_it_meet_first(loaded: Page) -> None:
    script = """
    const { firstVoxel } = await load("data/ray_walk");
    const filled = new Set(given.voxels.map(String));
    return given.rays.map(([from, direction]) =>
      firstVoxel({ from, direction, low: [0, 0, 0], high: [16, 16, 16] }, (...at) => filled.has(String(at))));
    """
    random = np.random.default_rng(5)
    grid = random.random((16, 16, 16)) < 0.03
    starts = random.uniform(-6, 22, (40, 3))
    ends = random.uniform(0, 16, (40, 3))
    rays = [[a.tolist(), ((b - a) / np.linalg.norm(b - a)).tolist()] for a, b in zip(starts, ends, strict=True)]
    met = run(loaded, script, {"voxels": np.argwhere(grid).tolist(), "rays": rays})
    assert met == [_stepped(grid, np.array(start), np.array(direction)) for start, direction in rays]
    assert sum(one is not None for one in met) > 10


def _stepped(grid: Any, start: Any, direction: Any) -> Any:
    steps = np.floor(np.arange(0, 60, 0.0005)[:, None] * direction + start).astype(int)
    steps = steps[((steps >= 0) & (steps < 16)).all(axis=1)]
    met = np.flatnonzero(grid[tuple(steps.T)])
    return steps[met[0]].tolist() if len(met) else None


def test_the_grid_of_the_modules_is_the_grid_of_the_labels(loaded: Page) -> None:
    script = "const { SHAPE, VOXEL_M, GRID_MIN_M } = await load('data/formats'); return [SHAPE, VOXEL_M, GRID_MIN_M];"
    assert run(loaded, script) == [list(SHAPE), 0.2, [-25.6, -25.6, -2]]


def test_a_place_just_below_zero_has_no_minus_before_its_zero(loaded: Page) -> None:
    script = """
    const { Readout } = await load("controls/readout");
    const readout = new Readout({ profile: "imported" }, () => undefined);
    const picked = { id: 1, index: [0, 0, 0], centre_m: [-0.04, 0.04, -12.34], kind: 3, seen: true, found: null };
    readout.say({ ...picked, scope: "frame", difference: null });
    return readout.element.querySelector("dd").textContent;
    """
    assert run(loaded, script) == "0.0, 0.0, -12.3 m"
