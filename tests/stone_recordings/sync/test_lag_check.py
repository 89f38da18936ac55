"""What is said of poses and sweeps of two times, and what is not."""

from dataclasses import replace

import pytest

from stone.sensors.sweep_lag import SweepLag
from stone_recordings.sync.lag_check import TOLERATED_NS, lag_findings

CERTAIN = SweepLag(16, 100_000_000, 2_000_000, 0.002, 0.02)


def test_a_certain_lag_is_named_with_the_options_that_put_it_right() -> None:
    (finding,) = lag_findings(CERTAIN)
    assert (finding.code, finding.severity) == ("TIM-213", "warning")
    assert "stamps of the poses are about 100 ms later than those of the sweeps" in finding.message
    assert "pose=-100ms or lidar=100ms" in finding.message
    (early,) = lag_findings(replace(CERTAIN, lag_ns=-60_000_000))
    assert "stamps of the sweeps are about 60 ms later than those of the poses" in early.message
    assert "pose=60ms or lidar=-60ms" in early.message


@pytest.mark.parametrize(
    "doubtful",
    [
        None,
        replace(CERTAIN, lag_ns=TOLERATED_NS),
        replace(CERTAIN, lag_ns=-TOLERATED_NS),
        replace(CERTAIN, sigma_ns=20_000_000),
        replace(CERTAIN, lag_ns=60_000_000, sigma_ns=14_000_000),
        replace(CERTAIN, unshifted_rad=0.0025),
    ],
)
def test_what_is_small_or_uncertain_is_not_named(doubtful: SweepLag | None) -> None:
    assert lag_findings(doubtful) == ()
