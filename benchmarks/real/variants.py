"""The variants of every recording: every profile, each with one option at a time."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.real.description import Described, Passes
from benchmarks.real.opening import ThinnedSweeps, opened
from services.ingest.pipeline import Ground, SynchroniseOptions
from services.labeler.parameters import (
    LabelParameters,
    RefinementParameters,
    Solver,
    chosen_parameters,
)
from stone.labels.profiles import Profile
from stone.sensors.sequence import Sequence, SweepSource

PROFILES: tuple[Profile, ...] = ("paper", "local", "field")
FOOTPRINT_ALONE = "footprint alone"


@dataclass(frozen=True)
class Option:
    """One changed setting. `choices` are parameters by dotted name, as in `stone label` and on the pages."""

    name: str
    profiles: tuple[Profile, ...] = PROFILES
    ground: Ground = "given"
    odometry_topic: str | None = None
    refinement: RefinementParameters | None = None
    solver: Solver = "lattice"
    choices: Mapping[str, float] = field(default_factory=dict)
    ring_every: int = 1
    track: str | None = None

    def parameters(self, profile: Profile) -> LabelParameters:
        """Return the profile's parameters with this option's change. Raises `bad_parameter`."""
        given = chosen_parameters(profile, self.choices)
        surface = replace(given.surface, solver=self.solver)
        return replace(given, surface=surface, refinement=self.refinement)

    def opened(self, described: Described) -> tuple[Sequence, SweepSource]:
        """Return the sequence opened with this option. Raises what `benchmarks.real.opening.opened` raises."""
        reading = SynchroniseOptions(ground=self.ground, odometry_topic=self.odometry_topic)
        sequence, sweeps = opened(described, reading, self.track)
        if self.ring_every == 1:
            return sequence, sweeps
        return sequence, ThinnedSweeps(sweeps, self.ring_every, described.description.ring_spacing_deg)


# A line here is a row for every recording; for a scan, a row for every path of its description.
OPTIONS = (
    Option("default"),
    Option("--ground auto", ground="auto"),
    Option("--odometry-topic kiss-icp", odometry_topic="kiss-icp"),
    Option("--refine-poses small_gicp", refinement=RefinementParameters()),
    Option("--solver octree", solver="octree"),
    Option("surface.min_frames=2", choices={"surface.min_frames": 2}),
    Option("reference.outlier_ratio=0.25", profiles=("local", "field"), choices={"reference.outlier_ratio": 0.25}),
    Option("every 2nd ring", ring_every=2),
    Option("every 4th ring", ring_every=4),
)


def options_of(described: Described) -> tuple[Option, ...]:
    """Return the options that fit the recording, in order."""
    description = described.description
    if description.scan is None:
        return OPTIONS
    return (Option(FOOTPRINT_ALONE), *(Option(f"track: {name}", track=name) for name in description.tracks_m))


def rows_of_pass(kind: Passes, frames: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the frames of two passes: even and odd numbers, or the first half and the second."""
    rows = np.arange(frames)
    return (rows[::2], rows[1::2]) if kind == "parity" else (rows[: frames // 2], rows[frames // 2 :])
