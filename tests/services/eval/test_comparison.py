"""Two folders of labels: what is counted, by an oracle; what is drawn; what is refused."""

import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from services.domain.viewer.frame_picture import DIFFERENCE_RGB, GREY, SAME_ALPHA, difference_picture
from services.eval.comparison.folders import compare_folders, open_folders, write_pictures
from stone.scoring.agreement import EASIER, HARDER, ONLY_A, ONLY_B, SAME
from stone_base.errors import StoneError
from stone_files.npz import npz_bytes
from stone_submissions.errors import UnreadableInputError
from testing.refusals import refused_as
from tests.plain_confusion import confusion_matrix

SHAPE = (256, 256, 32)
TOKENS = tuple(f"{number:032x}" for number in range(1, 4))
Grid = NDArray[np.uint8]


def random_grid(seed: int, occupied_ratio: float = 0.05) -> Grid:
    """Classes 1 to 3 in so many of the voxels, free elsewhere."""
    rng = np.random.default_rng(seed)
    grid = rng.integers(1, 4, SHAPE, dtype=np.uint8)
    grid[rng.random(SHAPE, dtype=np.float32) >= occupied_ratio] = 0
    return grid


def write_labels(folder: Path, frames: Mapping[str, Mapping[str, Grid]], sequence: str = "forest") -> Path:
    """`gts/<sequence>/<token>/labels.npz` of these arrays."""
    for token, arrays in frames.items():
        path = folder / "gts" / sequence / token / "labels.npz"
        path.parent.mkdir(parents=True)
        path.write_bytes(npz_bytes(arrays))
    return folder


def distance_m() -> np.ndarray:
    """Of each voxel's column from the robot."""
    half = [(np.arange(n) + 0.5) * 0.2 - 25.6 for n in SHAPE[:2]]
    return np.broadcast_to(np.hypot(half[0][:, None], half[1])[..., None], SHAPE)


def test_what_is_counted_is_what_a_loop_over_the_voxels_counts(tmp_path: Path) -> None:
    a = {token: {"semantics": random_grid(i), "mask_lidar": random_grid(10 + i, 0.5)} for i, token in enumerate(TOKENS)}
    b = {token: {"semantics": random_grid(20 + i), "mask_lidar": random_grid(30 + i, 0.5)} for i, token in
         enumerate(TOKENS[1:])}  # fmt: skip
    record = compare_folders(open_folders(write_labels(tmp_path / "a", a), write_labels(tmp_path / "b", b)))
    assert (record["frames"], record["only_in_a"], record["only_in_b"]) == (2, 1, 0)
    everywhere = np.ones(SHAPE, np.bool_)
    where_seen = {token: (a[token]["mask_lidar"] != 0) & (b[token]["mask_lidar"] != 0) for token in b}

    def counted(masks: dict[str, np.ndarray]) -> list[list[int]]:
        return sum(
            confusion_matrix(a[token]["semantics"], b[token]["semantics"], mask) for token, mask in masks.items()
        ).tolist()  # type: ignore[union-attr]  # a sum of arrays

    assert record["all_voxels"]["confusion"] == counted(dict.fromkeys(b, everywhere))
    assert record["seen_in_both"]["confusion"] == counted(where_seen)
    for ring in record["all_voxels"]["rings"]:
        is_within = (distance_m() >= ring["from_m"]) & (distance_m() < (ring["to_m"] or np.inf))
        assert ring["confusion"] == counted(dict.fromkeys(b, is_within))
    seen = record["seen_voxels"]
    assert seen["both"] == sum(int(mask.sum()) for mask in where_seen.values())
    assert seen["both"] + seen["only_a"] == sum(int((a[token]["mask_lidar"] != 0).sum()) for token in b)
    assert [frame["token"] for frame in record["least_alike"]] == sorted(b, key=lambda token: next(
        one["agreement_ratio"] for one in record["least_alike"] if one["token"] == token
    ))  # fmt: skip


def test_a_label_set_agrees_with_itself_and_no_frame_is_shown(tmp_path: Path) -> None:
    folder = write_labels(tmp_path, {TOKENS[0]: {"semantics": random_grid(1)}})
    opened = open_folders(folder, folder / "gts")
    record = compare_folders(opened)
    assert record["has_equal_classes"]
    assert record["least_alike"] == []
    assert record["all_voxels"]["agreement_ratio"] == 1.0
    assert record["all_voxels"]["ratios"] == dict.fromkeys(("iou_occ", "iou_t", "iou_p", "iou_n", "miou"), 1.0)
    assert record["seen_in_both"] is None
    assert record["seen_voxels"] is None
    assert write_pictures(opened, record, tmp_path / "pictures") == []


def test_the_picture_shows_the_gravest_difference_of_each_column(tmp_path: Path) -> None:
    a, b = (np.zeros(SHAPE, np.uint8) for _ in range(2))
    columns = {(0, 0): (SAME, (1, 1)), (0, 1): (ONLY_A, (2, 0)), (0, 2): (ONLY_B, (0, 2)), (0, 3): (HARDER, (1, 3)),
               (0, 4): (EASIER, (3, 1))}  # fmt: skip
    for (x, y), (_, (of_a, of_b)) in columns.items():
        a[x, y, 3], b[x, y, 3] = of_a, of_b
        a[x, y, 0] = b[x, y, 0] = 1  # alike, and less grave
    with Image.open(io.BytesIO(difference_picture(a, b))) as picture:
        pixels = np.asarray(picture.convert("RGBA"))[::2, ::2]
    for (x, y), (code, _) in columns.items():
        shown = (*GREY, SAME_ALPHA) if code == SAME else (*DIFFERENCE_RGB[code], 255)
        assert tuple(pixels[255 - x, 255 - y]) == shown
    assert pixels[0, 0, 3] == 0
    opened = open_folders(
        write_labels(tmp_path / "a", {TOKENS[0]: {"semantics": a}}),
        write_labels(tmp_path / "b", {TOKENS[0]: {"semantics": b}}),
    )
    (path,) = write_pictures(opened, compare_folders(opened), tmp_path / "pictures")
    assert path.name == f"{TOKENS[0]}.png"
    with Image.open(path) as picture:
        assert picture.size == (1568, 540)


def test_label_sets_of_different_runs_are_refused_with_the_likely_reason(tmp_path: Path) -> None:
    a, b = (write_labels(tmp_path / name, {token: {"semantics": random_grid(1)}}) for name, token in
            (("a", TOKENS[0]), ("b", TOKENS[1])))  # fmt: skip
    with refused_as("nothing_in_common"):
        open_folders(a, b)
    with pytest.raises(UnreadableInputError):
        open_folders(a, tmp_path / "c")


@pytest.mark.parametrize(
    "arrays",
    [
        {"semantics": np.full(SHAPE, 4, np.uint8)},
        {"mask_lidar": np.zeros(SHAPE, np.uint8)},
        {"semantics": np.zeros(SHAPE, np.uint8), "logits": np.zeros(3, np.uint8)},
        {"semantics": np.zeros((255, 256, 32), np.uint8)},
        {"semantics": np.zeros(SHAPE, np.int8)},
    ],
)
def test_a_label_file_that_is_none_is_refused_by_its_name(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    good = write_labels(tmp_path / "good", {TOKENS[0]: {"semantics": random_grid(1)}})
    bad = write_labels(tmp_path / "bad", {TOKENS[0]: arrays})
    with pytest.raises(StoneError, match=TOKENS[0]) as refusal:
        compare_folders(open_folders(good, bad))
    assert refusal.value.code in ("bad_ground_truth", "unknown_grid")
