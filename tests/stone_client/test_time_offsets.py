"""What is written for an offset of a clock is read to the nanosecond, or refused with what may be written."""

import pytest
import typer

from stone_local.time_offsets import chosen_offsets


def test_offsets_are_read_to_the_nanosecond_in_every_unit() -> None:
    assert chosen_offsets(["lidar=-18s", "pose=12.5ms"]) == {"lidar": -18 * 10**9, "pose": 12_500_000}
    assert chosen_offsets(["lidar=+0.000000001s"]) == {"lidar": 1}
    assert chosen_offsets(["pose=7us", "pose=3ns"]) == {"pose": 3}
    assert chosen_offsets([]) == {}


@pytest.mark.parametrize("choice", ["lidar", "lidar=18", "camera=1s", "lidar=1e3s", "lidar=1m", "lidar=nans", "=1s"])
def test_what_is_no_offset_is_refused_with_how_to_write_one(choice: str) -> None:
    with pytest.raises(typer.BadParameter, match=r"write lidar=-18s or pose=12\.5ms"):
        chosen_offsets([choice])


def test_more_than_a_quarter_of_an_hour_is_a_slip_of_the_unit() -> None:
    with pytest.raises(typer.BadParameter, match="is the unit right"):
        chosen_offsets(["lidar=1001s"])
