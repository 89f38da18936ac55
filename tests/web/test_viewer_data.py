"""What the viewer makes of the bytes of the scene's routes, beside the arrays they were made of.

**Conventions.** The built modules run in the browser on what the real routes answer; what comes back is compared with
NumPy. Faces are compared with the slow definition: a face is seen where the voxel beside it is empty.
"""

import json
import shutil
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zstandard
from playwright.sync_api import Browser, Page
from scipy.optimize import nnls

from services.domain.viewer.formats import voxels_bytes
from stone.geometry.se3 import SE3
from stone_base.label_grid import PAPER, RELEASE, LabelGrid
from testing.api.serving import person, serving
from testing.servers.fixtures import make_settings, opened
from testing.web.browsing import Site
from testing.worlds.viewer_world import Grid, Run, observed_of, viewed
from web.main import make_site

RUN = Run(frames=2, reach_m=3.0, has_confidence=True)
IMPORTS = (
    f"const PAPER = {json.dumps(PAPER.as_record())};"
    + """
const base = document.querySelector('script[src*="modules/app.js"]').src.replace("app.js", "viewer/");
const load = name => import(base + name + ".js");
const unpacked = async content => (await import(base + "../../libraries/fzstd/esm/index.mjs")).decompress(content);
const fetched = async path => unpacked(new Uint8Array(await (await fetch(path)).arrayBuffer()));
"""
)


@dataclass(frozen=True)
class Loaded:
    """A page that may import the viewer's modules, of the owner of a run."""

    page: Page
    sequence_id: str
    tokens: list[str]


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path, browser: Browser) -> Iterator[Loaded]:
    settings = make_settings(tmp_path_factory.mktemp("modules"))
    settings.root.mkdir(parents=True)
    shutil.copyfile(_sqlite_template, settings.root / "stone.sqlite3")
    platform = opened(settings, [])
    curator = person(platform, "curator")
    facts = viewed(platform, curator, RUN)
    with serving(platform, make_site(platform)) as url, Site(url, platform, browser).visit(curator) as page:
        page.goto("/sign-in", wait_until="domcontentloaded")
        yield Loaded(page, facts["id"], facts["tokens"])
    platform.database.close()


def run(loaded: Loaded, script: str, given: object = None) -> Any:
    return loaded.page.evaluate(f"async given => {{ {IMPORTS} {script} }}", given)


def test_a_frame_decodes_to_the_classes_and_the_mask_it_was_packed_of(loaded: Loaded) -> None:
    script = """
    const { planesOf, labelled, classAt, isObserved } = await load("data/formats");
    const planes = planesOf(await fetched(`/api/v1/frames/${given}/voxels`), PAPER);
    const indices = [...labelled(planes)];
    return indices.map(index => [index, classAt(planes, index), Number(isObserved(planes, index))]);
    """
    grid = RUN.grids[1]
    flat = grid.ravel()
    at = np.flatnonzero(flat)
    wanted = np.stack([at, flat[at], observed_of(grid).ravel()[at]], axis=1)
    np.testing.assert_array_equal(run(loaded, script, loaded.tokens[1]), wanted)


def test_a_tile_decodes_to_the_voxels_it_was_made_of(loaded: Loaded) -> None:
    script = """
    const { tileOf } = await load("data/formats");
    const content = await fetched(`/api/v1/sequences/${given}/scene/tiles/0_0`);
    const [tile, older] = [tileOf(content), tileOf(content.slice(0, 8 + 29 * (content.length - 8) / 30))];
    const listed = tile => Object.fromEntries(Object.entries(tile).map(([name, values]) => [name, [...values]]));
    return [listed(tile), listed(older)];
    """
    (tile, older), voxels = run(loaded, script, loaded.sequence_id), RUN.voxels
    np.testing.assert_array_equal(np.stack([tile["i"], tile["j"], tile["k"]], axis=1), voxels.indices)
    np.testing.assert_array_equal(tile["classes"], voxels.classes)
    features = np.stack([tile["elevation_m"], tile["slope_rad"], tile["roughness"]], axis=1)
    np.testing.assert_allclose(features, voxels.features, rtol=1e-6)
    np.testing.assert_allclose(tile["d2"], voxels.distance_squared, rtol=1e-6)
    np.testing.assert_array_equal(tile["confidence"], voxels.confidence)
    assert older == tile | {"confidence": [0] * len(voxels.classes)}


def test_confidence_is_coloured_from_a_half_to_one_and_grey_where_unknown(loaded: Loaded) -> None:
    script = """
    const { colourOf } = await load("looks");
    const look = { mode: "confidence", classes: 0b1110, unseen: "show" };
    return given.map(confidence => colourOf(look, 2, true, { confidence }, {}));
    """
    wanted = [255, 10, 10, 10 + round(240 * (2 * 200 / 255 - 1)), 250]
    assert run(loaded, script, [0, 1, 127, 200, 255]) == wanted


def test_what_is_not_a_frame_is_refused(loaded: Loaded) -> None:
    script = """
    const { planesOf } = await load("data/formats");
    return given.map(bytes => { try { planesOf(new Uint8Array(bytes), PAPER); return false; } catch { return true; } });
    """
    another_magic, many_planes = [83, 84, 86, 50, 3, 0, 0, 0], [83, 84, 86, 49, 9, 0, 0, 0]
    cut, short = [83, 84, 86, 49, 3, 0, 0, 0, 1], [83, 84, 86, 49]
    assert run(loaded, script, [another_magic, many_planes, cut, short]) == [True] * 4


def test_merged_faces_cover_exactly_the_faces_whose_neighbour_is_empty(loaded: Loaded) -> None:
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


def test_a_ray_meets_the_voxel_that_small_steps_along_it_meet_first(loaded: Loaded) -> None:
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


GRIDS = {
    "paper": (PAPER, 4),
    "release": (RELEASE, 2),
    "low": (LabelGrid("low", (-3.0, 1.0, -5.0), 0.6, (24, 16, 8)), 1),
    "wide": (LabelGrid("wide", (-0.8, -40.0, -1.0), 0.2, (8, 320, 16)), 4),
}
"""Grids, and how many columns the sides of a square have whose floor is told."""


@pytest.mark.parametrize(("grid", "square"), GRIDS.values(), ids=GRIDS)
def test_a_frame_is_drawn_picked_and_seen_by_cameras_in_its_own_grid(
    loaded: Loaded, grid: LabelGrid, square: int
) -> None:
    """Catches alone a side, a corner or a height of another grid: faces, floor and rays against NumPy's."""
    script = """
    const { Model } = await load("data/model"), { planesOf } = await load("data/formats");
    const { castRays, columnsOf } = await load("data/columns");
    const look = { mode: "class", classes: 14, unseen: "show" }, { grid } = given;
    const frames = { tokens: ["a"], map_from_ego: [given.pose] };
    const model = new Model({ grid, map_voxel_m: 0.2, frames, tiles: [] });
    const planes = planesOf(await unpacked(Uint8Array.from(atob(given.voxels), one => one.charCodeAt(0))), grid);
    model.keepFrame("a", "class", planes);
    const { faces, lowest, corner_m, voxel_m } = model.drawFrame("a", look);
    const picked = given.rays.map(([from_m, direction]) => model.pick({ from_m, direction }, "frame", "a", look));
    const ids = new Uint32Array(given.rays.length);
    castRays(columnsOf(planes, false), given.start, Float32Array.from(given.sights.flat()), ids);
    const centres = picked.map(one => one && one.centre_m);
    const told = picked.map(one => one && [one.id, one.kind, ...one.voxel]);
    const drawn = { vertices: [...faces.vertices], lowest: [...lowest], corner_m, voxel_m };
    return { ...drawn, ids: [...ids], picked: told, centres };
    """
    random = np.random.default_rng(11)
    classes = np.zeros(grid.shape, np.uint8)
    voxels = random.integers(0, grid.shape, (900, 3))
    classes[tuple(voxels.T)] = random.integers(1, 4, 900)
    pose = SE3(np.array([*np.array([0.9, 0.1, -0.2, 0.4]) / np.sqrt(1.02), 12.0, -7.0, 3.0]))
    middle = np.array(grid.shape) / 2 + (0.21, -0.33, 0.17)  # rays from a corner run along edges
    starts = middle + random.normal(0, 1, (60, 3)) * 40
    to_metres = lambda points: points * grid.voxel_m + grid.min_m  # noqa: E731
    aims = voxels[random.integers(0, 900, 60)] + 0.5
    sights = (aims - middle).astype(np.float32)
    given = {
        "grid": grid.as_record(),
        "pose": np.concatenate([pose.translation_m, pose.wxyz]).tolist(),
        "voxels": b64encode(voxels_bytes(classes, classes)).decode(),
        "rays": np.stack([pose @ to_metres(starts), pose @ to_metres(aims) - pose @ to_metres(starts)], 1).tolist(),
        "start": middle.tolist(),
        "sights": sights.tolist(),
    }
    made = run(loaded, script, given)
    assert sorted(_covered(np.array(made["vertices"]).reshape(-1, 4, 4))) == sorted(_exposed(classes))
    assert (made["corner_m"], made["voxel_m"]) == (list(grid.min_m), grid.voxel_m)
    assert made["lowest"] == _floor(classes, square).ravel().tolist()
    met = [_walked(classes, start, aim - start) for start, aim in zip(starts, aims, strict=True)]
    found = [one and one[2:] for one in made["picked"]]
    assert sum(a == b for a, b in zip(found, met, strict=True)) >= 58, "a ray through an edge may meet either"
    for one, centre_m in zip(made["picked"], made["centres"], strict=True):
        if one:
            assert one[:2] == [np.ravel_multi_index(one[2:], grid.shape) + 1, classes[tuple(one[2:])]]
            assert centre_m == pytest.approx(pose @ to_metres(np.array(one[2:]) + 0.5))
    near = 0.1 / grid.voxel_m / np.linalg.norm(sights, axis=1, keepdims=True)
    seen = [_walked(classes, middle + sight * skipped, sight) for sight, skipped in zip(sights, near, strict=True)]
    ids = [int(np.ravel_multi_index(one, grid.shape)) + 1 if one else 0 for one in seen]
    assert sum(a == b for a, b in zip(made["ids"], ids, strict=True)) >= 58


def _floor(classes: Grid, square: int) -> Any:
    """The lowest label of each square of columns, −1 where there is none."""
    x, y, z = classes.shape
    squares = np.asarray(classes.reshape(x // square, square, y // square, square, z).any(axis=(1, 3)))
    return np.where(squares.any(axis=2), squares.argmax(axis=2), -1)


def _walked(classes: Grid, start: Any, along: Any) -> Any:
    """The first voxel that steps of a thousandth of a voxel meet, up to twice as far as `along` goes."""
    at = np.arange(0, 2, 0.001 / np.linalg.norm(along))
    steps = np.floor(at[:, None] * along + start).astype(int)
    steps = steps[((steps >= 0) & (steps < classes.shape)).all(axis=1)]
    met = np.flatnonzero(classes[tuple(steps.T)])
    return steps[met[0]].tolist() if len(met) else None


def test_a_voxel_of_several_of_the_maps_has_the_values_of_a_part_of_its_own_class(loaded: Loaded) -> None:
    script = """
    const { Model } = await load("data/model"), { planesOf } = await load("data/formats");
    const grid = { shape: [8, 8, 8], min_m: [-3.2, -3.2, 0], voxel_m: 0.8 };
    const frames = { tokens: ["a"], map_from_ego: [[0, 0, 0, 1, 0, 0, 0]] };
    const model = new Model({ grid, map_voxel_m: 0.2, frames, tiles: [] });
    model.keepFrame("a", "class", planesOf(Uint8Array.from(given.planes), grid));
    const n = given.k.length, none = new Float32Array(n), zeros = new Uint8Array(n);
    const tile = { i: zeros, j: zeros, k: given.k, classes: given.classes, elevation_m: none, slope_rad: none,
      roughness: none, d2: given.d2, confidence: zeros };
    model.tiles.keep({ min_m: [0, 0, 0], max_m: [1, 1, 9] }, tile);
    const look = { mode: "class", classes: 14, unseen: "show" };
    return given.ids.map(id => model.pickedAt("a", id, look).found?.d2 ?? null);
    """
    classes = np.zeros((8, 8, 8), np.uint8)
    classes[4, 4, :4] = 3, 2, 1, 3
    ids = (np.ravel_multi_index(np.array([[4, 4, k] for k in range(4)]).T, classes.shape) + 1).tolist()
    planes = zstandard.decompress(voxels_bytes(classes, classes))
    # A pile of voxels of the map in one corner: P under N in a voxel of N, N under P in one of P, P in one of T, none.
    pile = {"k": [0, 3, 4, 7, 8], "classes": [2, 3, 3, 2, 2], "d2": [1, 2, 3, 4, 5]}
    assert run(loaded, script, {"planes": list(planes), "ids": ids, **pile}) == [2, 4, None, None]


SIGMAS = np.array([0.05, 0.07, 0.7])
COVARIANCE = np.outer(SIGMAS, SIGMAS) * np.array([[1.0, 0.7, 0.6], [0.7, 1.0, 0.8], [0.6, 0.8, 1.0]])


def test_one_sided_distances_are_the_least_of_all_ground_at_least_as_hard(loaded: Loaded) -> None:
    script = """
    const { partsOf } = await load("controls/explanation");
    const d2 = (away, sides) => partsOf(away, given.covariance, sides).reduce((a, b) => a + b);
    return given.aways.map(away => [d2(away, true), d2(away, false)]);
    """
    aways = np.random.default_rng(7).normal(0, 2.5, (200, 3)) * SIGMAS
    made = np.array(run(loaded, script, {"aways": aways.tolist(), "covariance": COVARIANCE.tolist()}))
    root = np.linalg.inv(np.linalg.cholesky(COVARIANCE))
    least = [nnls(root, -root @ away)[1] ** 2 for away in aways]
    assert made[:, 0] == pytest.approx(least, abs=1e-9)
    assert made[:, 1] == pytest.approx([away @ np.linalg.solve(COVARIANCE, away) for away in aways])
    assert (made[:, 0] < 0.5 * made[:, 1]).sum() > 50
    assert 10 < (made[:, 0] == 0).sum() < 100


@pytest.mark.parametrize(
    ("profile", "elevation_m", "d2", "words"),
    [
        ("field", 0.2, 16.0, "mainly in height above the local ground (0.20 m against 0.00 ± 0.05 m)"),
        ("field", 0.2, 40.0, "mainly in height above the local ground"),
        ("field", -0.2, 30.0, "beyond what the vehicle can do: slope under the footprint, step or clearance"),
        ("field", -0.2, 0.5, "no harder than the terrain driven over, and within the vehicle's limits"),
        ("local", -0.2, 16.0, "mainly in height above the local ground (-0.20 m"),
        ("paper", -0.2, 16.0, "mainly in elevation (-0.20 m"),
        ("paper", 0.0, 0.5, "similar to the terrain driven over"),
    ],
)
def test_the_reason_of_a_class_is_that_of_its_profile(
    loaded: Loaded, profile: str, elevation_m: float, d2: float, words: str
) -> None:
    script = """
    const { reason } = await load("controls/explanation");
    const reference = { mean: [0, 0, 0], covariance: given.covariance, d2_limit: 7.815 };
    const found = { elevation_m: given.elevation_m, slope_rad: 0, roughness: 0, d2: given.d2 };
    return reason({ kind: 3, seen: true, found }, { profile: given.profile, reference });
    """
    covariance = np.diag(SIGMAS**2).tolist()
    given = {"profile": profile, "elevation_m": elevation_m, "d2": d2, "covariance": covariance}
    assert words in run(loaded, script, given)


CLOCKS = [
    ("2026-03-29T02:30", "Europe/Berlin", "2026-03-29T01:30:00.000Z"),  # left out in spring: 03:30
    ("2026-03-08T02:30", "America/New_York", "2026-03-08T07:30:00.000Z"),
    ("2026-10-25T03:30", "Europe/Berlin", "2026-10-25T02:30:00.000Z"),
    ("2026-07-01T12:00:07", "Europe/Berlin", "2026-07-01T10:00:07.000Z"),
    ("2026-01-01T00:00", "Etc/GMT+12", "2026-01-01T12:00:00.000Z"),
    ("2026-01-01T05:45", "Asia/Kathmandu", "2026-01-01T00:00:00.000Z"),
]


def test_a_clocks_hour_is_an_instant(loaded: Loaded) -> None:
    script = """
    const { instantOf } = await import(base + "../moments.js");
    return given.map(([wall, zone]) => new Date(instantOf(wall, zone)).toISOString());
    """
    given = [[wall, zone] for wall, zone, _ in CLOCKS]
    assert run(loaded, script, given) == [instant for _, _, instant in CLOCKS]
