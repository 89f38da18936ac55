"""Scores, validation and manifests at every grid, held against the slow metric; attacks at every grid."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.main import get_command

from services.eval.examination import Examination, examine
from services.eval.ground_truth import read_truth
from services.eval.pipeline import score
from services.eval.truth_pack import TruthPack, write_truth_pack
from services.runtime.sandbox import SandboxWatch
from stone.scoring.metric import RATIOS
from stone.scoring.score_record import SequenceFacts, SubmissionCounts, record_of
from stone_base.label_grid import GRIDS, PAPER, RELEASE, LabelGrid
from stone_client.main import app
from stone_files.grid_file import GRID_FILE, grid_text
from stone_files.npz import npz_bytes
from stone_submissions.archive import frame_file, write_files
from stone_submissions.ground_truth import Mask, find_ground_truth
from stone_submissions.manifest import read_manifest, write_manifest
from stone_submissions.validation import validate
from testing.refusals import refused_as
from tests.services.eval.grid_attacks import GRID_ATTACKS, OWN, TOKENS
from tests.slow_metric import added, slow_counts, slow_ratios

Grid = NDArray[np.uint8]
EVERY_GRID = (*GRIDS.values(), OWN)
STONE = get_command(app)


def speckled(seed: int, grid: LabelGrid) -> Grid:
    rng = np.random.default_rng(seed)
    return np.where(rng.random(grid.shape) < 0.03, rng.integers(0, 4, grid.shape), 0).astype(np.uint8)


def laid(folder: Path, grid: LabelGrid) -> dict[str, Grid]:
    """Ground truth of two frames in a folder; the grid beside it unless its shape tells."""
    labels = {token: speckled(seed, grid) for seed, token in enumerate(TOKENS)}
    for token, semantics in labels.items():
        path = folder / "gts" / "s" / token / "labels.npz"
        path.parent.mkdir(parents=True)
        path.write_bytes(npz_bytes({"semantics": semantics}))
    if grid.name not in GRIDS:
        (folder / GRID_FILE).write_text(grid_text(grid))
    return labels


@pytest.mark.parametrize("grid", EVERY_GRID, ids=lambda grid: grid.name)
def test_a_submission_scores_as_the_slow_metric_says(grid: LabelGrid, tmp_path: Path) -> None:
    truth = laid(tmp_path / "truth", grid)
    guesses = {token: speckled(10 + seed, grid) for seed, token in enumerate(TOKENS)}
    zip_path = tmp_path / "sub.zip"
    write_files(zip_path, ((token, frame_file(guess, grid)) for token, guess in guesses.items()))
    record = score(zip_path, tmp_path / "truth").as_record()
    everywhere, place = np.ones(grid.shape, np.bool_), tuple(round(1000 * m) for m in (*grid.min_m[:2], grid.voxel_m))
    counts = [slow_counts(truth[token], guesses[token], everywhere, place) for token in TOKENS]  # type: ignore[arg-type]
    cells, _ = added(counts)
    assert record["confusion"] == cells
    expected = slow_ratios(cells, "stone-iou-2")
    assert [record["total"][name] for name in RATIOS] == pytest.approx([expected[name] for name in RATIOS], rel=1e-12)
    for ring, name in enumerate(record["by"]["distance"]):
        of_ring = [[sum(one.confusion[ring][t][p] for one in counts) for p in range(4)] for t in range(4)]
        assert record["by"]["distance"][name]["iou_occ"] == slow_ratios(of_ring, "stone-iou-2")["iou_occ"]
    shape = "x".join(map(str, grid.shape))
    assert f"grid:{shape}@{grid.voxel_m}m" in record["signature"]


def test_signatures_of_two_grids_differ(tmp_path: Path) -> None:
    laid(tmp_path / "a", OWN)
    shifted = replace(OWN, name="shifted", min_m=(0.2, -12.8, -1.6))
    write_files(tmp_path / "sub.zip", ((token, frame_file(speckled(9, OWN), OWN)) for token in TOKENS))
    signatures = {score(tmp_path / "sub.zip", tmp_path / "a", grid=grid).signature for grid in (OWN, shifted)}
    assert len({str(signature).partition("|grid:")[2] for signature in signatures}) == 2


@pytest.mark.parametrize("grid", [PAPER, RELEASE, OWN], ids=lambda grid: grid.name)
def test_a_pack_gives_back_what_was_written_and_its_grid(grid: LabelGrid, tmp_path: Path) -> None:
    laid(tmp_path / "truth", grid)
    truth = find_ground_truth(tmp_path / "truth")
    paths = truth.paths()
    write_truth_pack(tmp_path / "p", truth.manifest, lambda token: read_truth(paths[token], "all", grid))
    with TruthPack(tmp_path / "p") as pack:
        assert pack.grid == grid
        for token in TOKENS:
            expected = read_truth(paths[token], "all", grid)
            np.testing.assert_array_equal(pack.planes_of(token).planes, expected.planes)
            assert pack.planes_of(token).grid == grid


def test_a_manifest_names_its_grid_unless_it_is_the_papers(tmp_path: Path) -> None:
    for grid in (PAPER, RELEASE, OWN):
        laid(tmp_path / grid.name, grid)
        manifest = find_ground_truth(tmp_path / grid.name).manifest
        write_manifest(tmp_path / f"{grid.name}.json", manifest)
        assert read_manifest(tmp_path / f"{grid.name}.json") == manifest
        assert manifest.grid == grid
        assert ('"grid"' in (tmp_path / f"{grid.name}.json").read_text()) == (grid != PAPER)
    path = tmp_path / "own.json"
    path.write_text(path.read_text().replace("0.4", "0.3"))
    with refused_as("bad_manifest"):
        read_manifest(path)


def test_labels_of_a_shape_that_no_grid_has_are_refused_until_one_is_named(tmp_path: Path) -> None:
    laid(tmp_path / "truth", OWN)
    (tmp_path / "truth" / GRID_FILE).unlink()
    with refused_as("unknown_grid"):
        find_ground_truth(tmp_path / "truth")
    assert find_ground_truth(tmp_path / "truth", grid=OWN).manifest.grid == OWN


@dataclass(frozen=True)
class Standing:
    """Ground truth at a grid: as a folder with its manifest, as the server's pack."""

    grid: LabelGrid
    folder: Path
    manifest: Path
    pack: Path


@pytest.fixture(scope="module", params=EVERY_GRID, ids=lambda grid: grid.name)
def standing(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Standing:
    grid, folder = request.param, tmp_path_factory.mktemp("standing")
    laid(folder, grid)
    truth = find_ground_truth(folder, grid=grid)
    paths = truth.paths()
    write_manifest(folder / "manifest.json", truth.manifest)
    write_truth_pack(folder / "pack", truth.manifest, lambda token: read_truth(paths[token], "all", grid))
    return Standing(grid, folder, folder / "manifest.json", folder / "pack")


def told(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[object, dict[str, object]]:
    """The exit code and the JSON of a command."""
    with pytest.raises(SystemExit) as ended:
        STONE([*map(str, arguments), "--json"])
    return ended.value.code, json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("attack", GRID_ATTACKS)
def test_a_hostile_submission_has_one_code_everywhere_at_every_grid(
    attack: str, standing: Standing, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`stone validate`, `stone score` and the server's stage, which counts in a confined process."""
    case, path = GRID_ATTACKS[attack], tmp_path / "sub.zip"
    path.write_bytes(case.made(standing.grid))
    verdict = validate(path, standing.manifest)
    assert {error.code for error in verdict.errors} == {case.code}
    assert case.words(standing.grid) in " ".join(f"{error.expected} {error.actual}" for error in verdict.errors)
    assert told(capsys, "validate", path, "--manifest", standing.manifest) == (1, verdict.as_record())
    assert told(capsys, "score", path, "--ground-truth", standing.folder) == (1, verdict.as_record())
    counted = examine(Examination(path, TOKENS, (0, 2), standing.pack, standing.grid), SandboxWatch())
    assert (counted.validation, counted.counts) == (verdict, None)


def plain_ious(truth: Grid, guess: Grid, is_counted: NDArray[np.bool_]) -> dict[str, float]:
    """The paper's ratios of arrays of any shape, as its text defines them: numpy alone."""
    t, p = truth[is_counted], guess[is_counted]
    found = {"iou_occ": np.sum((t > 0) & (p > 0)) / np.sum((t > 0) | (p > 0))}
    for name, number in (("iou_t", 1), ("iou_p", 2), ("iou_n", 3)):
        found[name] = np.sum((t == number) & (p == number)) / np.sum((t == number) | (p == number))
    return {name: float(share) for name, share in found.items()} | {"miou": float(np.mean(list(found.values())[1:]))}


def ring_numbers(grid: LabelGrid) -> NDArray[np.int64]:
    """0, 1 or 2 of each column within 10 m, within 20 m, beyond; by its centre, in whole millimetres."""
    x, y = (
        round(1000 * low_m) + round(500 * grid.voxel_m) * (2 * np.arange(size) + 1)
        for low_m, size in zip(grid.min_m[:2], grid.shape[:2], strict=True)
    )
    squared = x[:, None] ** 2 + y[None, :] ** 2
    return np.asarray((squared >= 10_000**2).astype(int) + (squared >= 20_000**2))


NEAR = LabelGrid("near", (0.0, -40.0, -1.0), 0.4, RELEASE.shape)  # the release's shape, elsewhere
FINE = LabelGrid("fine", (-20.0, -20.0, -1.0), 0.2, RELEASE.shape)  # the release's shape, other voxels


@pytest.mark.parametrize("mask", ["all", "lidar", "camera"])
@pytest.mark.parametrize("grid", [*EVERY_GRID, NEAR, FINE], ids=lambda grid: grid.name)
def test_command_and_server_score_as_a_few_lines_of_numpy_at_every_grid_and_mask(
    grid: LabelGrid, mask: Mask, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two grids of one shape have one total and other rings: a shape alone tells no place."""
    arrays, guesses = dict[str, dict[str, Grid]](), dict[str, Grid]()
    for seed, token in enumerate(TOKENS):
        semantics, random = speckled(seed, grid), np.random.default_rng(90 + seed)
        lidar, camera = (random.integers(0, 2, grid.shape).astype(np.uint8) for _ in range(2))
        arrays[token] = {"semantics": semantics, "mask_lidar": lidar, "mask_camera": camera}
        guesses[token] = np.where(random.random(grid.shape) < 0.7, semantics, speckled(10 + seed, grid)).astype(
            np.uint8
        )
        path = tmp_path / "gts" / "s" / token / "labels.npz"
        path.parent.mkdir(parents=True)
        path.write_bytes(npz_bytes(arrays[token]))
    if grid.name not in GRIDS:
        (tmp_path / GRID_FILE).write_text(grid_text(grid))
    classes = {token: one["semantics"] for token, one in arrays.items()}
    write_files(tmp_path / "s.zip", ((token, frame_file(one, grid)) for token, one in guesses.items()))
    truth, guess = (np.stack([of[token] for token in TOKENS]) for of in (classes, guesses))
    seen = {one: np.stack([arrays[token][f"mask_{one}"] for token in TOKENS]) > 0 for one in ("lidar", "camera")}
    is_counted = {"all": np.ones_like(truth, np.bool_), **seen}[mask]
    expected = plain_ious(truth, guess, is_counted)

    code, record = told(capsys, "score", tmp_path / "s.zip", "--ground-truth", tmp_path, "--mask", mask)
    assert code == 0
    assert record["total"] == pytest.approx(expected, rel=1e-12)
    for ring, part in enumerate(record["by"]["distance"].values()):  # type: ignore[index]
        is_here = is_counted & (ring_numbers(grid) == ring)[None, :, :, None]
        if is_here.any():
            assert {name: part[name] for name in RATIOS} == pytest.approx(plain_ious(truth, guess, is_here), rel=1e-12)

    found = find_ground_truth(tmp_path)
    paths = found.paths()
    assert found.manifest.grid.geometry == grid.geometry
    write_truth_pack(tmp_path / "pack", found.manifest, lambda token: read_truth(paths[token], mask, grid))
    counted = examine(Examination(tmp_path / "s.zip", TOKENS, (0, 2), tmp_path / "pack", grid), SandboxWatch()).counts
    assert counted is not None
    counts = SubmissionCounts(counted.confusions, counted.bev, (SequenceFacts("s", 2),), counted.column_counts)
    of_server = record_of(counts, counts.spectra())
    assert of_server["total"] == record["total"]
    assert of_server["by"]["distance"] == record["by"]["distance"]  # type: ignore[index]


def test_the_hint_of_a_shape_is_by_the_grid_that_is_expected() -> None:
    with refused_as("bad_shape") as refusal:
        frame_file(np.zeros((16, 200, 200), np.uint8), RELEASE)
    assert "grid.transpose(1, 2, 0)" in str(refusal.value)
