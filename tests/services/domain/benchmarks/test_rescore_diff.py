"""What a difference between two evaluation versions says of the board's order."""

import pytest

from services.domain.benchmarks.rescores.diff import RescoreDiff, RescoreMove, RescoreSide


def diff_of(*ranks: tuple[int | None, int | None]) -> RescoreDiff:
    """A difference of entries, numbered from 0, with these ranks before and after."""
    rows = [
        RescoreMove(str(number), "team", "method", "lidar", "entry", None, None, *both)
        for number, both in enumerate(ranks)
    ]
    return RescoreDiff(None, RescoreSide("truth", 1, "stone-iou-2"), tuple(rows))


@pytest.mark.parametrize(
    ("ranks", "is_order_changed", "is_new_leader"),
    [
        ([(1, 1), (2, 2), (None, None)], False, False),
        ([(1, 1), (2, 3), (3, 2)], True, False),
        ([(1, 2), (2, 1)], True, True),
        ([(1, 1), (2, None)], True, False),
        ([(1, 1), (None, 2)], True, False),
        ([(1, 1), (1, 1)], False, False),
    ],
)
def test_an_order_is_another_where_any_entry_has_another_rank_or_stands_on_one_board_only(
    ranks: list[tuple[int | None, int | None]], is_order_changed: bool, is_new_leader: bool
) -> None:
    found = diff_of(*ranks)
    assert (found.is_order_changed, found.is_new_leader) == (is_order_changed, is_new_leader)
