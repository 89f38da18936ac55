"""The ratios of a confusion: laws, closed forms, and an oracle on sets of voxels."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import (
    iou_classes,
    iou_occupied,
    named_ratios,
    ratios,
    supports,
    within_occupied,
)
from stone.scoring.signature import Signature
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


@given(PAIRS, st.integers(0, 40))
def test_parts_add_to_the_whole(pair: Labels, cut: int) -> None:
    truth, prediction = pair
    is_first = np.arange(40) < cut
    parts = confusion_matrix(truth, prediction, is_first) + confusion_matrix(truth, prediction, ~is_first)
    np.testing.assert_array_equal(parts, confusion_matrix(truth, prediction, EVERYWHERE))


@given(PAIRS)
def test_swapping_truth_and_prediction_transposes_and_keeps_every_ratio(pair: Labels) -> None:
    truth, prediction = pair
    forth = confusion_matrix(truth, prediction, EVERYWHERE)
    np.testing.assert_array_equal(forth.T, confusion_matrix(prediction, truth, EVERYWHERE))
    assert named_ratios(forth) == named_ratios(forth.T)


def test_a_perfect_prediction_scores_one() -> None:
    truth = np.tile(np.arange(4, dtype=np.uint8), 10)
    perfect = confusion_matrix(truth, truth, EVERYWHERE)
    assert set(named_ratios(perfect).values()) == {1.0}
    assert set(named_ratios(within_occupied(perfect)).values()) == {1.0}


def test_a_disjoint_prediction_scores_zero() -> None:
    truth = np.tile(np.array([0, 1, 0, 2, 0, 3], np.uint8), 7)[:40]
    prediction = np.tile(np.array([1, 0, 2, 0, 3, 0], np.uint8), 7)[:40]
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


def test_shapes_that_are_no_confusion_are_refused() -> None:
    with pytest.raises(ShapeError, match=r"confusion has shape \(3, 3\)"):
        named_ratios(np.zeros((3, 3), np.int64))


def test_the_signature_names_all_that_a_score_depends_on() -> None:
    assert str(Signature(ground_truth="ab" * 32, mask="lidar")) == (
        "metric:stone-iou-2|truth:abababababababab|mask:lidar|grid:256x256x32@0.2m|classes:0=free,1=T,2=P,3=N"
    )
