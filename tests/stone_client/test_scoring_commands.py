"""`stone validate` and `stone score` on folders and archives written here."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from stone_client import scoring
from stone_local import scoring as by_kernels
from stone_submissions.ground_truth import Mask
from stone_submissions.verdict import SubmissionRefusedError
from tests.stone_client.participating import quiet, stone

TOKENS = ("0" * 32, "1" * 32)


def world() -> NDArray[np.uint8]:
    """A grid that holds every class."""
    grid = np.zeros((256, 256, 32), np.uint8)
    grid[100:150, 100:150, 10], grid[150:160, 100:150, 10], grid[20:30, 20:30, 5:20] = 1, 2, 3
    return grid


def write_zip(path: Path, grids: dict[str, NDArray[np.uint8]]) -> Path:
    with zipfile.ZipFile(path, "w") as archive:
        for token, grid in grids.items():
            with archive.open(f"{token}.npz", "w") as member:
                np.savez_compressed(member, semantics=grid)
    return path


@pytest.fixture
def truth(tmp_path: Path) -> Path:
    for token in TOKENS:
        folder = tmp_path / "truth" / "gts" / "field" / token
        folder.mkdir(parents=True)
        np.savez_compressed(folder / "labels.npz", semantics=world(), mask_lidar=np.ones_like(world()))
    return tmp_path / "truth"


@pytest.fixture
def manifest(tmp_path: Path) -> Path:
    path = tmp_path / "manifest.json"
    path.write_text(json.dumps({"stone_manifest": 1, "sequences": {"field": list(TOKENS)}}))
    return path


def test_a_perfect_prediction_is_valid_and_scores_one(tmp_path: Path, truth: Path, manifest: Path) -> None:
    submission = write_zip(tmp_path / "sub.zip", dict.fromkeys(TOKENS, world()))
    assert stone("validate", submission, "--manifest", manifest).exit_code == 0
    result = stone("score", submission, "--ground-truth", truth, "--json")
    assert result.exit_code == 0
    record = json.loads(result.stdout)
    assert record["frames"] == 2
    assert record["total"] == dict.fromkeys(("iou_occ", "iou_t", "iou_p", "iou_n", "miou"), 1.0)
    assert np.trace(record["confusion"]) == 2 * world().size
    assert record["signature"]


def test_a_least_confidence_leaves_out_the_errors_below_it_and_says_so(tmp_path: Path, truth: Path) -> None:
    """P has 0.8 = 204 / 255; all of it is predicted N."""
    grid = world()
    confidence = np.array([0, 255, 204, 250], np.uint8)[grid]
    for path in truth.glob("gts/*/*/labels.npz"):
        np.savez_compressed(path, semantics=grid, confidence=confidence)
    wrong = np.where(grid == 2, 3, grid).astype(np.uint8)
    submission = write_zip(tmp_path / "sub.zip", dict.fromkeys(TOKENS, wrong))
    limited = ("score", submission, "--ground-truth", truth, "--least-confidence")
    assert json.loads(stone(*limited, "0.8", "--json").stdout)["total"]["iou_p"] == 0.0
    record = json.loads(stone(*limited, "0.81", "--json").stdout)
    assert (record["total"]["iou_p"], record["total"]["iou_n"]) == (None, 1.0)
    share = 100 * (grid == 2).sum() / (grid > 0).sum()
    assert (
        f"2 frames; {share:.1f} % of occupied voxels left out (confidence below 0.81)" in stone(*limited, "0.81").stdout
    )


def test_a_missing_frame_is_refused_by_both_commands(tmp_path: Path, truth: Path, manifest: Path) -> None:
    submission = write_zip(tmp_path / "sub.zip", {TOKENS[0]: world()})
    for command in (("validate", submission, "--manifest", manifest), ("score", submission, "--ground-truth", truth)):
        result = stone(*command, "--json")
        assert result.exit_code == 1
        assert [line for line in result.stderr.splitlines() if line.startswith("missing_frame: ")]
        record = json.loads(result.stdout)
        assert (record["ok"], record["errors_total"]) == (False, 1)
        assert record["errors"][0]["code"] == "missing_frame"
        assert record["errors"][0]["frame"] == TOKENS[1]


def test_a_manifest_that_is_none_is_refused(tmp_path: Path, manifest: Path) -> None:
    manifest.write_text("{")
    submission = write_zip(tmp_path / "sub.zip", {TOKENS[0]: world()})
    result = stone("validate", submission, "--manifest", manifest, "--json")
    assert result.exit_code == 1
    assert json.loads(result.stdout)["findings"][0]["code"] == "bad_manifest"


def test_ground_truth_without_labels_is_refused(tmp_path: Path) -> None:
    submission = write_zip(tmp_path / "sub.zip", {TOKENS[0]: world()})
    (tmp_path / "empty").mkdir()
    result = stone("score", submission, "--ground-truth", tmp_path / "empty")
    assert result.exit_code == 1
    assert result.stderr.startswith("bad_ground_truth: ")


@pytest.mark.parametrize(("mask", "least_confidence"), [("all", 0.0), ("lidar", 0.0), ("all", 0.7)])
def test_without_the_platform_the_record_is_the_same(tmp_path: Path, mask: Mask, least_confidence: float) -> None:
    """But for the code that counted, and the order of frames in time, which the client does not read."""
    rng = np.random.default_rng(3)
    grids = dict[str, NDArray[np.uint8]]()
    for number in range(12):
        token = f"{number:032x}"
        folder = tmp_path / "truth" / "gts" / f"drive-{number // 2}" / token
        folder.mkdir(parents=True)
        truth = np.roll(world(), number, axis=0)
        extra = {name: rng.integers(0, 2, truth.shape, np.uint8) for name in ("mask_lidar", "late")}
        np.savez_compressed(
            folder / "labels.npz", semantics=truth, confidence=rng.integers(0, 256, truth.shape, np.uint8), **extra
        )
        is_wrong = rng.random(truth.shape, np.float32) < 0.1 + 0.02 * (number // 2)
        grids[token] = np.where(is_wrong, rng.integers(0, 4, truth.shape), truth).astype(np.uint8)
    submission = write_zip(tmp_path / "sub.zip", grids)
    ours, theirs = (
        of.score(
            submission, tmp_path / "truth", mask=mask, least_confidence=least_confidence, progress=quiet
        ).as_record()
        for of in (scoring, by_kernels)
    )
    assert ours.pop("code_version").startswith("stone-client ")
    theirs.pop("code_version")
    assert ours == theirs
    assert ours["intervals"]["new_place"]["iou_occ"] is not None
    assert ours["late"] is not None


def test_without_the_platform_a_wrong_frame_is_refused_with_all_others(tmp_path: Path, truth: Path) -> None:
    submission = write_zip(tmp_path / "sub.zip", {TOKENS[0]: world() + 7, TOKENS[1]: world()[:9]})
    with pytest.raises(SubmissionRefusedError) as caught:
        scoring.score(submission, truth, progress=quiet)
    assert [one.code for one in caught.value.validation.errors] == ["label_out_of_range", "bad_shape"]
