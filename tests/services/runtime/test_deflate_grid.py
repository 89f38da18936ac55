"""Every inflater gives back what was deflated; grids become small."""

import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray

from services.runtime.deflate_grid import code_sizes, code_words, deflate_grid

Bytes = NDArray[np.uint8]


def inflated(data: Bytes) -> bytes:
    return zlib.decompress(deflate_grid(data), wbits=-15)


@settings(max_examples=300, deadline=None)
@given(hnp.arrays(np.uint8, st.integers(0, 700), elements=st.integers(0, 2), fill=st.just(0)))
def test_short_and_sparse_bytes_survive(data: Bytes) -> None:
    assert inflated(data) == data.tobytes()


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 255), st.integers(1, 600)), max_size=40), st.integers(0, 40))
def test_runs_of_any_length_at_any_place_survive(runs: list[tuple[int, int]], head: int) -> None:
    data = np.frombuffer(bytes(range(head)) + b"".join(bytes([value]) * n for value, n in runs), np.uint8)
    assert inflated(data) == data.tobytes()


@pytest.mark.parametrize("ratio", [0.0, 0.001, 0.1, 1.0])
def test_grids_survive_and_sparse_ones_shrink(ratio: float) -> None:
    random = np.random.default_rng(0)
    data = np.where(random.random(2**18) < ratio, random.integers(0, 256, 2**18), 0).astype(np.uint8)
    assert inflated(data) == data.tobytes()
    assert len(deflate_grid(data)) <= 2**18 * (ratio * 4 + 0.01)


def test_columns_that_repeat_cost_next_to_nothing() -> None:
    column = np.random.default_rng(0).integers(0, 4, 32, dtype=np.uint8)
    data = np.tile(column, 65536)
    assert inflated(data) == data.tobytes()
    assert len(deflate_grid(data)) < 10_000


@given(hnp.arrays(np.int64, 286, elements=st.integers(0, 10**6), fill=st.just(0)))
def test_codes_are_complete_prefix_free_and_short(counts: NDArray[np.int64]) -> None:
    counts[:2] += 1
    sizes = code_sizes(counts)
    assert sizes.max() <= 14
    assert sum(2.0 ** -int(size) for size in sizes[sizes > 0]) == 1.0
    words = [f"{code:0{size}b}"[::-1] for code, size in zip(code_words(sizes), sizes, strict=True) if size]
    assert len(set(words)) == (counts > 0).sum()


def test_a_skewed_histogram_stays_within_the_limit() -> None:
    fibonacci = [1, 1]
    while len(fibonacci) < 40:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    assert code_sizes(np.array(fibonacci)).max() <= 14
