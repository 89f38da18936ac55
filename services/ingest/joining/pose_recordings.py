"""The offset of the recording that has the poses, where that is not the one with the LiDAR.

**Conventions.** Turns between sweeps, registered, are compared with those of the poses until they agree
(`stone_recordings.sync.lag_check`). Poses that bear GPS time are on no recorder's clock, so that nothing needs to be
moved for them; the recording's own clock is then measured like any other's, against them.
"""

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from pathlib import Path

from services.ingest.pipeline import SynchroniseOptions, unjoined_sequence
from stone.sensors.sweep_lag import SweepLag
from stone_files.joined_file import SWEEPS
from stone_recordings.bags.bag import Bag
from stone_recordings.calibrations.file import read_calibration
from stone_recordings.joining.clock_links import ClockOffset
from stone_recordings.joining.errors import UnmeasuredOffsetError
from stone_recordings.joining.held_messages import HeldMessages
from stone_recordings.sync.lag_check import MOST_SIGMA_NS, measured_lag
from stone_recordings.sync.sweeps import SweepsOfOpenBag
from stone_recordings.topics.roles import POSE_ROLES
from stone_recordings.topics.sources import KISS_ICP

ROUNDS = 4
OpenAt = Callable[[ClockOffset], AbstractContextManager[Bag]]


def has_poses(held: Iterable[HeldMessages], options: SynchroniseOptions) -> bool:
    """Whether these, or what is asked for, say where the robot was."""
    asked = options.odometry_topic or options.topics.get("pose")
    return options.poses is not None or asked == KISS_ICP or any(one.of_role(*POSE_ROLES) for one in held)


def best_poses(held: Iterable[HeldMessages]) -> HeldMessages | None:
    """The recording whose poses would be taken; None where none has any."""
    ranked = {role: rank for rank, role in enumerate(POSE_ROLES)}
    found = [(min(ranked[topic.role] for topic in topics), one) for one in held if (topics := one.of_role(*POSE_ROLES))]
    return min(found, key=lambda ranks: ranks[0])[1] if found else None


def bears_gps_time(held: HeldMessages) -> bool:
    """Whether the poses that would be taken of it do."""
    return bool(held.of_role("ins"))


def pose_offset(name: str, open_at: OpenAt, calibration: Path, options: SynchroniseOptions) -> ClockOffset:
    """Of the recording `name`; `open_at` opens the run with it at an offset.

    Raises: UnmeasuredOffsetError (SYN-523), and what synchronising raises.
    """
    offset_ns, sigma_ns = 0, 0
    for _ in range(ROUNDS):
        with open_at(ClockOffset(offset_ns, None, (SWEEPS,))) as bag:
            lag = _lag(bag, calibration, options)
        if lag is None or lag.sigma_ns > MOST_SIGMA_NS:
            raise UnmeasuredOffsetError([name], ["its poses and the sweeps turn too little to be compared"])
        offset_ns, sigma_ns = offset_ns - lag.lag_ns, lag.sigma_ns
        if 2 * abs(lag.lag_ns) < lag.sigma_ns:
            break
    return ClockOffset(offset_ns, sigma_ns, (SWEEPS,))


def _lag(bag: Bag, calibration: Path, options: SynchroniseOptions) -> SweepLag | None:
    rig, _ = read_calibration(calibration, bag)
    sequence, sweeps = unjoined_sequence(bag, rig, options, bag.path.stem)
    return measured_lag(sequence, SweepsOfOpenBag(sweeps, bag))
