"""Cosine coefficients are those of the definition; what is kept is what inference asks for."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.spectra import (
    FRAMES_PER_PERIOD,
    MOST_USED,
    OCTAVES_ABOVE,
    coefficients,
    layout_of,
    sums_of_sequences,
)

LENGTHS = st.lists(st.integers(1, 700), min_size=1, max_size=5)
Floats = NDArray[np.float64]


def slow_coefficients(influences: Floats, lengths: list[int], kept: tuple[int, ...]) -> Floats:
    """The oracle: cosine by cosine."""
    found, first = [], 0
    for frames, count in zip(lengths, kept, strict=True):
        own, t = influences[first : first + frames], np.arange(frames)
        for j in range(count):
            norm = np.sqrt((1 if j == 0 else 2) / frames)
            found.append(norm * (np.cos(np.pi * j * (t + 0.5) / frames)[:, None] * own).sum(axis=0))
        first += frames
    return np.array(found)


@given(LENGTHS, st.integers(0, 99))
def test_coefficients_are_those_of_the_definition(lengths: list[int], seed: int) -> None:
    layout = layout_of(lengths)
    influences = np.random.default_rng(seed).normal(size=(sum(lengths), 2))
    expected = slow_coefficients(influences, lengths, layout.kept)
    np.testing.assert_allclose(coefficients(influences, layout), expected, atol=1e-9)


@given(LENGTHS, st.integers(0, 99))
def test_sums_of_sequences_are_read_from_them(lengths: list[int], seed: int) -> None:
    influences = np.random.default_rng(seed).normal(size=(sum(lengths), 3))
    bounds = np.cumsum([0, *lengths])[:-1]
    found = sums_of_sequences(coefficients(influences, layout_of(lengths)), layout_of(lengths))
    np.testing.assert_allclose(found, np.add.reduceat(influences, bounds, axis=0), atol=1e-9)


@given(LENGTHS)
def test_no_more_is_kept_than_inference_looks_at_and_no_less(lengths: list[int]) -> None:
    layout = layout_of(lengths)
    used = layout.used(layout.shortest_period_frames)
    assert used.sum() <= MOST_USED
    assert np.all(np.array(layout.kept) <= lengths)
    assert sum(layout.kept) <= len(lengths) + MOST_USED * 2**OCTAVES_ABOVE
    assert np.all(np.array(layout.kept) > used)


@given(LENGTHS)
def test_steps_of_period_are_those_of_the_frequencies(lengths: list[int]) -> None:
    layout = layout_of(lengths)
    assert len(layout.steps) == len(layout.frequencies) == sum(layout.kept)
    for step, frequency in zip(layout.steps.tolist(), layout.frequencies.tolist(), strict=True):
        if step > -1000:
            period = np.pi / (FRAMES_PER_PERIOD * frequency)
            assert layout.period_frames(step) <= period * (1 + 1e-6)
            assert period < layout.period_frames(step + 1) * (1 + 1e-6)


def test_lengths_that_do_not_add_up_are_refused() -> None:
    for lengths in ([4, 4], [9, 0], []):
        with pytest.raises(ShapeError, match="sequences of a frame or more each"):
            coefficients(np.zeros((9, 5)), layout_of(lengths))
