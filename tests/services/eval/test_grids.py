"""Scores, validation and manifests at every grid, held against the slow metric; attacks at the release's grid."""

import io
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from services.eval.ground_truth import find_ground_truth, read_truth
from services.eval.pipeline import score
from services.eval.truth_pack import TruthPack, write_truth_pack
from stone.scoring.metric import RATIOS
from stone_base.label_grid import GRIDS, PAPER, RELEASE, LabelGrid
from stone_files.grid_file import GRID_FILE, grid_text
from stone_files.npz import npz_bytes
from stone_submissions.archive import frame_file, write_files
from stone_submissions.manifest import read_manifest, write_manifest
from stone_submissions.validation import validate
from stone_submissions.verdict import SubmissionRefusedError
from testing.refusals import refused_as
from tests.slow_metric import added, slow_counts, slow_ratios

Grid = NDArray[np.uint8]
OWN = LabelGrid("own", (0.0, -12.8, -1.6), 0.4, (64, 64, 16))
TOKENS = ("0" * 31 + "1", "0" * 31 + "2")


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


@pytest.mark.parametrize("grid", [*GRIDS.values(), OWN], ids=lambda grid: grid.name)
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


def saved(**arrays: NDArray[np.generic]) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
    return file.getvalue()


def bomb() -> bytes:
    """A npy that its directory says is of the grid's size, and goes on for 64 MiB."""
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "|u1", "fortran_order": False, "shape": RELEASE.shape})
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("semantics.npy", head.getvalue() + bytes(64 * 2**20))
    content, size = bytearray(file.getvalue()), len(head.getvalue())
    declared = (size + RELEASE.voxels).to_bytes(4, "little")
    true = (size + 64 * 2**20).to_bytes(4, "little")
    return bytes(content.replace(true, declared))


GOOD = np.zeros(RELEASE.shape, np.uint8)
BEYOND = GOOD.copy()
BEYOND[3, 4, 5] = 255
ATTACKS: dict[str, tuple[str, Callable[[], bytes], str]] = {
    "the paper's grid": ("bad_shape", lambda: saved(semantics=np.zeros(PAPER.shape, np.uint8)), "(200, 200, 16)"),
    "z first": ("bad_shape", lambda: saved(semantics=np.zeros((16, 200, 200), np.uint8)), "(16, 200, 200)"),
    "scores": ("bad_shape", lambda: saved(semantics=np.zeros((4, *RELEASE.shape), np.uint8)), "(4, 200, 200, 16)"),
    "Fortran order": ("bad_shape", lambda: saved(semantics=np.asfortranarray(GOOD)), "C order"),
    "int64": ("bad_dtype", lambda: saved(semantics=GOOD.astype(np.int64)), "'<i8'"),
    "unknown in a prediction": ("label_out_of_range", lambda: saved(semantics=BEYOND), "255"),
    "the release's own key": ("missing_array", lambda: saved(label=GOOD), "label"),
    "a bomb": ("too_large", bomb, "continues"),
    "cut": ("truncated", lambda: saved(semantics=GOOD)[:200], ""),
}


@pytest.mark.parametrize("attack", ATTACKS)
def test_what_is_no_frame_of_the_releases_grid_is_refused(attack: str, tmp_path: Path) -> None:
    code, make, words = ATTACKS[attack]
    laid(tmp_path / "truth", RELEASE)
    manifest = tmp_path / "m.json"
    write_manifest(manifest, find_ground_truth(tmp_path / "truth").manifest)
    write_files(tmp_path / "sub.zip", [(TOKENS[0], make()), (TOKENS[1], frame_file(GOOD, RELEASE))])
    verdict = validate(tmp_path / "sub.zip", manifest)
    (error,) = verdict.errors
    assert error.code == code
    assert words in f"{error.expected} {error.actual}"
    with pytest.raises(SubmissionRefusedError):
        score(tmp_path / "sub.zip", tmp_path / "truth")


def test_the_hint_of_a_shape_is_by_the_grid_that_is_expected() -> None:
    with refused_as("bad_shape") as refusal:
        frame_file(np.zeros((16, 200, 200), np.uint8), RELEASE)
    assert "grid.transpose(1, 2, 0)" in str(refusal.value)
