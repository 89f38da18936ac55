"""Ratios of a confusion and of an agreement: laws, closed forms, oracles on voxels; what the written metrics say."""

from hashlib import sha256

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.labels.voxels import VOXEL_M
from stone.scoring.agreement import DIFFERENCES, agreement_ratios, differences
from stone.scoring.confusion import iou_classes, iou_occupied, named_ratios, ratios, supports, within_occupied
from stone.scoring.metric import (
    CLASS_NAMES,
    METRIC_VERSION,
    METRICS,
    OCCUPIED_VERSION,
    RATIOS,
    current_metric,
    metric_of,
)
from stone.scoring.plane_layout import RING_EDGES_M
from stone.scoring.signature import Signature
from stone_base.label_grid import PAPER
from testing.refusals import refused_as
from tests.plain_confusion import confusion_matrix

Labels = NDArray[np.uint8]
PAIRS = hnp.arrays(np.uint8, (2, 40), elements=st.integers(0, 3))
EVERYWHERE = np.ones(40, np.bool_)


def iou_of_sets(truth: set[int], prediction: set[int]) -> float | None:
    """The oracle: the definition, on sets of voxel numbers."""
    union = truth | prediction
    return len(truth & prediction) / len(union) if union else None


def voxels(labels: Labels, *classes: int) -> set[int]:
    return {index for index, label in enumerate(labels) if label in classes}


@given(PAIRS)
def test_the_ratios_are_those_of_sets_of_voxels(pair: Labels) -> None:
    truth, prediction = pair
    found = named_ratios(confusion_matrix(truth, prediction, EVERYWHERE))
    assert found["iou_occ"] == iou_of_sets(voxels(truth, 1, 2, 3), voxels(prediction, 1, 2, 3))
    parts = [iou_of_sets(voxels(truth, c), voxels(prediction, c)) for c in (1, 2, 3)]
    assert [found["iou_t"], found["iou_p"], found["iou_n"]] == parts
    defined = [part for part in parts if part is not None]
    assert found["miou"] == (pytest.approx(sum(defined) / 3) if len(defined) == 3 else None)


@given(PAIRS)
def test_within_occupied_forgets_voxels_that_are_free_in_truth(pair: Labels) -> None:
    truth, prediction = pair
    found = named_ratios(within_occupied(confusion_matrix(truth, prediction, EVERYWHERE)))
    inside = voxels(truth, 1, 2, 3)
    parts = [iou_of_sets(voxels(truth, c), voxels(prediction, c) & inside) for c in (1, 2, 3)]
    assert [found["iou_t"], found["iou_p"], found["iou_n"]] == parts


def test_a_perfect_prediction_scores_one_and_a_disjoint_one_zero() -> None:
    truth = np.tile(np.arange(4, dtype=np.uint8), 10)
    perfect = confusion_matrix(truth, truth, EVERYWHERE)
    assert set(named_ratios(perfect).values()) == set(named_ratios(within_occupied(perfect)).values()) == {1.0}
    truth, prediction = (
        np.resize(np.array(labels, np.uint8), 40) for labels in ([0, 1, 0, 2, 0, 3], [1, 0, 2, 0, 3, 0])
    )
    assert set(named_ratios(confusion_matrix(truth, prediction, EVERYWHERE)).values()) == {0.0}


def test_a_class_absent_from_both_is_undefined_and_so_is_the_mean() -> None:
    truth = np.tile(np.array([0, 1, 2], np.uint8), 14)[:40]
    confusion = confusion_matrix(truth, truth, EVERYWHERE)
    found = named_ratios(confusion)
    assert (found["iou_t"], found["iou_p"], found["iou_n"], found["miou"]) == (1.0, 1.0, None, None)
    assert supports(confusion) == {"free": 14, "T": 13, "P": 13, "N": 0}


def test_a_class_only_ever_invented_scores_zero_not_null() -> None:
    truth, prediction = np.zeros(40, np.uint8), np.full(40, 3, np.uint8)
    found = named_ratios(confusion_matrix(truth, prediction, EVERYWHERE))
    assert (found["iou_n"], found["iou_occ"], found["iou_t"]) == (0.0, 0.0, None)


def test_nothing_evaluated_leaves_everything_undefined() -> None:
    empty = confusion_matrix(np.zeros(40, np.uint8), np.zeros(40, np.uint8), ~EVERYWHERE)
    assert set(named_ratios(empty).values()) == {None}


def test_batches_are_read_like_single_confusions() -> None:
    batch = np.random.default_rng(0).integers(0, 9, (3, 5, 4, 4))
    for index in np.ndindex(3, 5):
        single = named_ratios(batch[index])
        assert float(iou_occupied(batch)[index]) == single["iou_occ"]
        assert list(iou_classes(batch)[index]) == [single["iou_t"], single["iou_p"], single["iou_n"]]
        assert float(ratios(batch)[index][-1]) == single["miou"]


def test_int32_counts_do_not_overflow_in_a_union() -> None:
    full = np.full((4, 4), 2**31 - 1, np.int32)
    assert named_ratios(full)["iou_occ"] == pytest.approx(9 / 15)


def test_the_signature_names_all_that_a_score_depends_on() -> None:
    assert str(Signature(ground_truth="ab" * 32, mask="lidar")) == (
        "metric:stone-iou-2|truth:abababababababab|mask:lidar|grid:256x256x32@0.2m|classes:0=free,1=T,2=P,3=N"
    )


def difference_in_words(a: int, b: int) -> str:
    """The oracle: the definition, of one voxel."""
    if a == b:
        return "same class" if a else "both free"
    if not b:
        return "only in A"
    if not a:
        return "only in B"
    return "easier in B" if b < a else "harder in B"


@given(PAIRS)
def test_the_agreement_is_the_share_of_equal_voxels_of_those_occupied_in_either(pair: Labels) -> None:
    a, b = pair
    found = float(agreement_ratios(confusion_matrix(a, b, EVERYWHERE)))
    occupied = [(one, other) for one, other in zip(a, b, strict=True) if one or other]
    if not occupied:
        assert np.isnan(found)
    else:
        assert found == sum(one == other for one, other in occupied) / len(occupied)


@given(PAIRS)
def test_every_voxel_differs_as_the_definition_says(pair: Labels) -> None:
    a, b = pair
    assert [DIFFERENCES[code] for code in differences(a, b)] == list(map(difference_in_words, a, b))


def test_other_shapes_are_refused() -> None:
    for ask in (named_ratios, agreement_ratios):
        with pytest.raises(ShapeError):
            ask(np.zeros((3, 3), np.int64))
    with pytest.raises(ShapeError):
        differences(np.zeros(3, np.uint8), np.zeros(4, np.uint8))


@pytest.mark.parametrize("version", METRICS)
def test_a_definition_names_the_numbers_of_the_code(version: str) -> None:
    text = " ".join(metric_of(version).definition.split())
    assert text.startswith(f"# {version}: ")
    ranges = " × ".join(f"[{low}, {high})" for low, high in zip(PAPER.min_m, PAPER.max_m, strict=True))
    assert ranges.replace("-", "−") in text
    assert " × ".join(map(str, PAPER.shape)) + f" voxels of {VOXEL_M} m" in text
    near, far = RING_EDGES_M
    assert f"0–{near:g}, {near:g}–{far:g}, from {far:g} m" in text
    for index, name in enumerate(CLASS_NAMES):
        assert f"{index} {name}" in text or f"({name})" in text


def test_an_unknown_metric_is_refused() -> None:
    for ask in (metric_of, lambda version: ratios(np.zeros((4, 4), np.int64), version)):
        with refused_as("unknown_metric"):
            ask("stone-iou-9")


@pytest.mark.parametrize("version", [METRIC_VERSION, OCCUPIED_VERSION])
def test_what_went_before_a_version_has_its_ratios_and_scores_nothing_anew(version: str) -> None:
    before = next(metric for metric in METRICS.values() if metric.successor == version)
    confusion = np.random.default_rng(1).integers(1, 99, (4, 4))
    assert named_ratios(confusion, before.version) == named_ratios(confusion, version)
    assert current_metric(version).version == version
    with refused_as("superseded_metric"):
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
