"""Real ranges in the simulated LiDAR: shares against their formulas, and where disturbed points lie."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from simulator.sensors.range_noise import RangeNoise, Ranges, Returns, detected_share, disturbed, mixed, rained
from tests.simulator.conftest import TINY, Recording

NOISE = RangeNoise()
RAYS = 200_000
CHANNELS = 4


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(1)


def ranges(value_m: float, count: int = RAYS) -> Ranges:
    return np.full(count, value_m, np.float32)


def met(range_m: float, cosine: float, reflectivity: float = 0.3) -> Returns:
    return Returns(ranges(range_m), ranges(cosine), ranges(reflectivity))


def stepped(near_m: float, far_m: float, columns: int) -> Ranges:
    """Columns that see a near surface and a far one in turn."""
    return np.tile(np.repeat(np.array([near_m, far_m], np.float32), CHANNELS), columns // 2)


def test_half_of_the_pulses_come_back_where_the_data_sheet_says_so() -> None:
    share = detected_share(met(NOISE.half_range_m, 1.0, NOISE.half_reflectivity), NOISE)
    assert share[0] == pytest.approx(0.5, abs=1e-6)


@given(st.floats(0.5, 80.0), st.floats(0.03, 0.9), st.floats(0.02, 1.0))
def test_dropouts_grow_with_incidence_and_range_and_shrink_with_reflectivity(
    range_m: float, cosine: float, reflectivity: float
) -> None:
    here, steeper, nearer, brighter = (
        detected_share(Returns(*(ranges(value, 1) for value in values)), NOISE)[0]
        for values in (
            (range_m, cosine, reflectivity),
            (range_m, cosine * 1.1, reflectivity),
            (range_m * 0.9, cosine, reflectivity),
            (range_m, cosine, reflectivity * 1.1),
        )
    )
    assert 0 <= here <= min(steeper, nearer, brighter)


def test_the_share_of_dropouts_is_the_models(rng: np.random.Generator) -> None:
    without_rain = replace(NOISE, drops_reach_m=0.0)
    for range_m in (5.0, 15.0, 30.0):
        ground = met(range_m, 1.0 / range_m)
        returned = np.isfinite(disturbed(ground, CHANNELS, without_rain, rng)).mean()
        assert returned == pytest.approx(detected_share(ground, NOISE)[0], abs=0.005)


def test_mixed_pixels_lie_between_the_two_surfaces_and_are_as_many_as_the_beam_is_wide(
    rng: np.random.Generator,
) -> None:
    columns = 900
    seen = np.concatenate([mixed(stepped(8.0, 9.0, columns), CHANNELS, NOISE, rng) for _ in range(60)])
    between = (seen > 8.0) & (seen < 9.0)
    assert seen.min() >= 8.0
    assert seen.max() <= 9.0
    assert between.mean() == pytest.approx(NOISE.beam_rad * columns / (2 * np.pi), abs=0.005)
    assert seen[between].mean() == pytest.approx(8.5, abs=0.01)


@pytest.mark.parametrize(("near_m", "far_m"), [(8.0, 8.05), (8.0, 10.0), (8.0, np.inf)])
def test_what_no_pulse_joins_is_not_mixed(near_m: float, far_m: float, rng: np.random.Generator) -> None:
    exact = stepped(near_m, far_m, 900)
    np.testing.assert_array_equal(mixed(exact, CHANNELS, NOISE, rng), exact)


def test_rain_stops_rays_at_its_rate_evenly_along_the_way_and_never_behind_a_surface(
    rng: np.random.Generator,
) -> None:
    heavy = replace(NOISE, drops_per_m=0.01)
    for range_m in (5.0, 15.0, 50.0, np.inf):
        reach_m = min(range_m, heavy.drops_reach_m)
        seen = rained(ranges(range_m), heavy, rng)
        drops = seen[seen != range_m]
        assert len(drops) / RAYS == pytest.approx(-np.expm1(-heavy.drops_per_m * reach_m), rel=0.04)
        assert drops.max() <= reach_m
        assert np.histogram(drops, 4, (0, reach_m))[0] / len(drops) == pytest.approx(0.25, abs=0.03)


def test_a_sky_without_rain_stays_without_returns(rng: np.random.Generator) -> None:
    sky = met(np.inf, 0.0, 0.0)
    assert not np.isfinite(disturbed(sky, CHANNELS, replace(NOISE, drops_reach_m=0.0), rng)).any()


def test_a_recording_has_it_only_where_it_is_asked_for(recording: Recording, tmp_path: Path) -> None:
    noisy = replace(TINY, range_noise=True)
    simulate(tmp_path / "noisy.mcap", noisy)
    simulate(tmp_path / "again.mcap", noisy)
    assert (tmp_path / "noisy.mcap").read_bytes() == (tmp_path / "again.mcap").read_bytes()
    assert (tmp_path / "noisy.mcap").read_bytes() != recording.path.read_bytes()
    assert SimulateOptions().range_noise is False
