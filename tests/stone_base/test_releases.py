"""Releases are compared by their numbers, and what is no release is neither older nor newer."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from stone_base.releases import is_older

NUMBERS = st.tuples(*[st.integers(0, 999_999)] * 3)


def spelled(numbers: tuple[int, ...]) -> str:
    return ".".join(map(str, numbers))


@given(NUMBERS, NUMBERS)
def test_the_older_release_is_that_of_the_smaller_numbers(one: tuple[int, ...], other: tuple[int, ...]) -> None:
    assert is_older(spelled(one), spelled(other)) == (one < other)


@pytest.mark.parametrize(
    ("release", "than", "is_it"),
    [("0.9.0", "0.10.0", True), ("0.9", "0.9.1", True), ("1.0.0", "1.0", False), ("0.9.0.dev3", "0.10.0", True)],
)
def test_a_release_is_read_as_packages_spell_it(release: str, than: str, is_it: bool) -> None:
    assert is_older(release, than) is is_it


@given(st.text(max_size=60).filter(lambda text: "." not in text) | st.sampled_from(["", "1" * 5000 + ".0", "٠.٠"]))
def test_what_is_no_release_is_not_older_than_any(text: str) -> None:
    assert not is_older(text, "999999.0.0")
