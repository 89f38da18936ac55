"""The check that poses and sweeps share a clock: registered turns between sweeps, compared with the turns of the poses.

**Conventions.** Without a turn, roll or pitch of the robot, a lag cannot be measured and there is no finding; neither
is there below `TOLERATED_NS`. The check uses pairs of sweeps from the whole run, half a second apart, at the frames at
which a lag has the most effect.
"""

import numpy as np
from numpy.typing import NDArray

from stone.findings import Finding
from stone.sensors.sequence import Sequence, SweepSource
from stone.sensors.sweep_lag import SLOPE_STEP_S, SweepLag, SweepTurns, sweep_lag
from stone_recordings.sync.ground_looks import seen_around
from stone_recordings.sync.registration import Target, Trust

PAIRS = 16
APART_NS, FARTHEST_NS = 500_000_000, 1_200_000_000
SAMPLING_M = 0.4
TRUST = Trust(residual_m=0.15, is_place_asked=False)
TOLERATED_NS = 30_000_000
MOST_SIGMA_NS, SIGMAS = 15_000_000, 5
WORSE_RATIO = 1.3


def measured_lag(sequence: Sequence, sweeps: SweepSource) -> SweepLag | None:
    """Return by how much the poses are late; None if this cannot be measured."""
    if sequence.track is None:
        return None
    turns = _turns(sequence, sweeps, telling_pairs(sequence))
    return sweep_lag(turns, sequence.track, sequence.max_pose_gap_ns)


def telling_pairs(sequence: Sequence) -> NDArray[np.int64]:
    """Return pairs of frames (K, 2) of one segment, about half a second apart, from each of `PAIRS` parts of the run.

    Each part contributes the pairs whose turn depends most on a delay of the poses by `SLOPE_STEP_S`.
    """
    stamps_ns, track = sequence.frames.stamps_ns, sequence.track
    first = np.arange(len(stamps_ns))
    second = np.searchsorted(stamps_ns, stamps_ns + APART_NS)
    first, second = first[second < len(stamps_ns)], second[second < len(stamps_ns)]
    near = stamps_ns[second] - stamps_ns[first] <= FARTHEST_NS
    first, second = first[near], second[near]
    if track is None or not len(first):
        return np.zeros((0, 2), np.int64)
    shift_ns = round(SLOPE_STEP_S * 1e9)
    turned = [
        track.at(stamps_ns[rows] + at_ns, sequence.max_pose_gap_ns).map_from_ego
        for rows in (first, second)
        for at_ns in (-shift_ns, shift_ns)
    ]
    before, after = turned[0].inverse() @ turned[2], turned[1].inverse() @ turned[3]
    cosine = np.abs(np.sum(before.wxyz * after.wxyz, axis=1))
    change = np.where(np.isfinite(cosine), np.arccos(np.clip(cosine, 0.0, 1.0)), -1.0)
    parts = [part for part in np.array_split(np.arange(len(first)), PAIRS) if len(part)]
    chosen = [int(part[np.argmax(change[part])]) for part in parts if change[part].max() >= 0]
    return np.stack([first[chosen], second[chosen]], axis=1).astype(np.int64)


def lag_findings(lag: SweepLag | None) -> tuple[Finding, ...]:
    """Return TIM-213 if poses and sweeps do not share a clock, with the options that correct it."""
    if lag is None or not _is_certain(lag):
        return ()
    late, other = ("poses", "sweeps") if lag.lag_ns > 0 else ("sweeps", "poses")
    ms = round(lag.lag_ns / 1e6)
    unshifted_deg, residual_deg = np.rad2deg([lag.unshifted_rad, lag.residual_rad]).tolist()
    sentence = (
        f"the stamps of the {late} are about {abs(ms)} ms later than those of the {other}. {lag.turns} turns of the "
        f"robot between sweeps are off by {unshifted_deg:.2f}°, without this delay by {residual_deg:.2f}°. The robot's "
        "motion in that time smears the labels. Add the time offset "
        f"pose={-ms}ms or lidar={ms}ms to the run's or to time_offset_ns in the calibration, for the sensor with the "
        "wrong clock; then check again"
    )
    return (Finding("TIM-213", "warning", "", sentence),)


def _is_certain(lag: SweepLag) -> bool:
    is_large = abs(lag.lag_ns) > max(TOLERATED_NS, SIGMAS * lag.sigma_ns)
    return is_large and lag.sigma_ns <= MOST_SIGMA_NS and lag.unshifted_rad > WORSE_RATIO * lag.residual_rad


def _turns(sequence: Sequence, sweeps: SweepSource, pairs: NDArray[np.int64]) -> SweepTurns:
    """Return the registered turns of these pairs of frames (K, 2), for the registrations that are accepted."""
    poses, stamps_ns = sequence.frames.map_from_ego, sequence.frames.stamps_ns
    kept, wxyz = list[tuple[int, int]](), list[NDArray[np.float64]]()
    for first, second in pairs.tolist():
        target = Target(seen_around(sequence, sweeps, first).astype(np.float64), SAMPLING_M)
        result = target.register(
            seen_around(sequence, sweeps, second).astype(np.float64), poses[first].inverse() @ poses[second], TRUST
        )
        if not result.doubt:
            kept.append((first, second))
            wxyz.append(result.target_from_source.wxyz)
    rows = np.array(kept, np.int64).reshape(-1, 2)
    return SweepTurns(stamps_ns[rows[:, 0]], stamps_ns[rows[:, 1]], np.array(wxyz).reshape(-1, 4))
