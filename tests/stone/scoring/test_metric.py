"""The written metrics say what the code does, in its own numbers."""

from hashlib import sha256

import numpy as np
import pytest

from stone.labels.grid import GRID_MAX_M, GRID_MIN_M, GRID_SHAPE
from stone.labels.voxels import VOXEL_M
from stone.scoring.bitplanes import RING_EDGES_M
from stone.scoring.confusion import named_ratios, ratios
from stone.scoring.metric import (
    CLASS_NAMES,
    METRIC_VERSION,
    METRICS,
    OCCUPIED_VERSION,
    RATIOS,
    SupersededMetricError,
    UnknownMetricError,
    current_metric,
    metric_of,
)


@pytest.mark.parametrize("version", METRICS)
def test_a_definition_names_the_numbers_of_the_code(version: str) -> None:
    text = " ".join(metric_of(version).definition.split())
    assert text.startswith(f"# {version}: ")
    ranges = " × ".join(f"[{low}, {high})" for low, high in zip(GRID_MIN_M, GRID_MAX_M, strict=True))
    assert ranges.replace("-", "−") in text
    assert " × ".join(map(str, GRID_SHAPE)) + f" voxels of {VOXEL_M} m" in text
    near, far = RING_EDGES_M
    assert f"0–{near:g}, {near:g}–{far:g}, from {far:g} m" in text
    for index, name in enumerate(CLASS_NAMES):
        assert f"{index} {name}" in text or f"({name})" in text
    for rule in ("label_out_of_range", "Free is not in the mean", "`null`, never 0 and never 1", "mIoU, then IoU_occ"):
        assert rule in text


@pytest.mark.parametrize("version", METRICS)
def test_a_definition_is_plain_markdown(version: str) -> None:
    text = metric_of(version).definition
    assert "<" not in text
    assert all(len(line) <= 120 for line in text.splitlines())
    assert all(character.isprintable() or character == "\n" for character in text)


def test_an_unknown_metric_is_refused() -> None:
    for ask in (metric_of, lambda version: ratios(np.zeros((4, 4), np.int64), version)):
        with pytest.raises(UnknownMetricError, match="there is no metric 'stone-iou-9'; there are stone-iou-2"):
            ask("stone-iou-9")


@pytest.mark.parametrize("version", [METRIC_VERSION, OCCUPIED_VERSION])
def test_what_went_before_a_version_has_its_ratios_and_scores_nothing_anew(version: str) -> None:
    before = next(metric for metric in METRICS.values() if metric.successor == version)
    confusion = np.random.default_rng(1).integers(1, 99, (4, 4))
    assert named_ratios(confusion, before.version) == named_ratios(confusion, version)
    assert current_metric(version).version == version
    with pytest.raises(SupersededMetricError, match=f"those of '{version}', which is what to name"):
        current_metric(before.version)


@pytest.mark.parametrize(
    ("version", "digest"),
    [
        ("stone-iou-1", "e9b9ef82888e608c32e4e74c746ebf21e3018c95a55cc50dc0566d1de9c3bee4"),
        ("stone-iou-occupied-1", "4522bc39f741a5c040e129753dd8040b5ca721a82ea1e60208a78b98fa9c7a38"),
    ],
)
def test_the_text_of_an_old_version_never_changes(version: str, digest: str) -> None:
    assert sha256(metric_of(version).definition.encode()).hexdigest() == digest


def test_the_metrics_differ_only_where_free_space_was_called_something() -> None:
    confusion = np.random.default_rng(0).integers(1, 99, (4, 4))
    everywhere, occupied = (named_ratios(confusion, version) for version in (METRIC_VERSION, OCCUPIED_VERSION))
    assert everywhere["iou_occ"] == occupied["iou_occ"]
    assert all((everywhere[name] or 0) < (occupied[name] or 0) for name in RATIOS[1:])
    confusion[0, 1:] = 0
    assert named_ratios(confusion, METRIC_VERSION) == named_ratios(confusion, OCCUPIED_VERSION)
