"""Student's t against SciPy's, and against the closed form of one degree."""

from math import atan, pi

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import special

from stone.scoring.student import critical_value, two_sided

DEGREES = st.floats(1.0, 1e4)  # beyond, the logarithm of gamma loses digits


@given(st.floats(0, 1e3), DEGREES)
def test_tails_are_those_of_another_implementation(t: float, degrees: float) -> None:
    assert two_sided(t, degrees) == pytest.approx(2 * special.stdtr(degrees, -t), rel=1e-9, abs=1e-300)


@given(st.floats(0.5, 0.9999), DEGREES)
def test_critical_values_are_those_of_another_implementation(level: float, degrees: float) -> None:
    assert critical_value(level, degrees) == pytest.approx(special.stdtrit(degrees, (1 + level) / 2), rel=1e-9)


@given(st.floats(-50, 50))
def test_one_degree_is_the_distribution_of_cauchy(t: float) -> None:
    assert two_sided(t, 1.0) == pytest.approx(1 - 2 * atan(abs(t)) / pi, rel=1e-12)
