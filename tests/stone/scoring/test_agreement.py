"""Agreement of two label sets: laws, closed forms, and an oracle voxel by voxel."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.agreement import DIFFERENCES, EASIER, HARDER, ONLY_A, ONLY_B, agreement_ratios, differences
from stone.scoring.confusion import named_ratios
from tests.plain_confusion import confusion_matrix

Labels = NDArray[np.uint8]
PAIRS = hnp.arrays(np.uint8, (2, 40), elements=st.integers(0, 3))
EVERYWHERE = np.ones(40, np.bool_)


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
def test_exchanging_the_two_changes_no_ratio(pair: Labels) -> None:
    a, b = pair
    forth, back = (confusion_matrix(*both, EVERYWHERE) for both in ((a, b), (b, a)))
    assert named_ratios(forth) == named_ratios(back)
    assert np.array_equal(agreement_ratios(forth), agreement_ratios(back), equal_nan=True)


@given(PAIRS)
def test_every_voxel_differs_as_the_definition_says(pair: Labels) -> None:
    a, b = pair
    assert [DIFFERENCES[code] for code in differences(a, b)] == list(map(difference_in_words, a, b))


@given(PAIRS)
def test_exchanging_the_two_turns_every_difference_round(pair: Labels) -> None:
    a, b = pair
    turned = {ONLY_A: ONLY_B, ONLY_B: ONLY_A, EASIER: HARDER, HARDER: EASIER}
    assert [turned.get(code, code) for code in differences(a, b)] == list(differences(b, a))


def test_label_sets_that_are_alike_agree_and_those_that_share_nothing_do_not() -> None:
    labels = np.array([0, 1, 2, 3] * 10, np.uint8)
    assert float(agreement_ratios(confusion_matrix(labels, labels, EVERYWHERE))) == 1.0
    assert float(agreement_ratios(confusion_matrix(labels, labels * 0, EVERYWHERE))) == 0.0


def test_other_shapes_are_refused() -> None:
    with pytest.raises(ShapeError, match="confusions"):
        agreement_ratios(np.zeros((3, 3), np.int64))
    with pytest.raises(ShapeError, match="that of a"):
        differences(np.zeros(3, np.uint8), np.zeros(4, np.uint8))
