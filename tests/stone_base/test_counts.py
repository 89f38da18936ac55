"""A number agrees with its noun."""

import pytest

from stone_base.counts import counted


@pytest.mark.parametrize(
    ("count", "words", "said"),
    [
        (0, ("sequence",), "0 sequences"),
        (1, ("sequence",), "1 sequence"),
        (12_345, ("frame",), "12,345 frames"),
        (1, ("entry", "entries"), "1 entry"),
        (2, ("entry", "entries"), "2 entries"),
    ],
)
def test_a_number_agrees_with_its_noun(count: int, words: tuple[str, ...], said: str) -> None:
    assert counted(count, *words) == said
