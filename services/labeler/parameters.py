"""All parameters of the labels in one frozen value, and the values of each profile."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, cast

from services.domain.sequences.label_choices import DEFAULT_PROFILE, check_choices
from stone.labels.observed_voxels import CarveParameters
from stone.labels.profiles import RULES, Profile, ProfileRule
from stone.labels.traversability import ReferenceParameters
from stone.sensors.ground_plane import BAND_M
from stone.sensors.selection import SelectionParameters
from stone.surface.range_image import DynamicParameters
from stone.surface.screened_poisson import PoissonParameters
from stone.surface.terrain import TerrainParameters
from stone_base.label_grid import PAPER, LabelGrid

Solver = Literal["lattice", "octree"]


@dataclass(frozen=True)
class SurfaceParameters:
    """Point map and Poisson reconstruction, by the solver of `stone/surface/screened_poisson.py` or by Open3D's octree.

    `width_m` is the cell of the lattice on which the surface is solved: a width and not an octree's depth, whose cell
    grows with the extent. Vertices farther than `trim_m` from any point are extrapolated and removed (a density
    quantile would keep many of them); the lattice extends at most one cell beyond the points.
    """

    point_voxel_m: float = 0.1
    min_frames: int = 1
    normal_neighbours: int = 20
    width_m: float = 0.2
    trim_m: float = 0.2
    solver: Solver = "lattice"
    poisson: PoissonParameters = field(default_factory=PoissonParameters)


@dataclass(frozen=True)
class TilingParameters:
    """The map is reconstructed in squares of `cube_cells` cells, which overlap by `halo_m` on each side in plan.

    256 cells of 0.2 m are the design's 51.2 m. The surface at a place follows from the points within about a metre, so
    with the halo it is the same in every tile. One task reads or crops `frames_per_part` frames.
    """

    cube_cells: int = 256
    halo_m: float = 1.6
    frames_per_part: int = 60


@dataclass(frozen=True)
class RefinementParameters:
    """Parameters of pose refinement (`services/labeler/map/refinement.py`).

    Sweeps are thinned to `sampling_m` and aligned with Gaussians of `voxel_m`. The two limits of a correction are
    several times the error of an RTK receiver or a short odometry. Each correction is reduced by `pull_ratio`, so that
    the alignment's own drift stays within twenty times that of one frame.
    """

    method: Literal["small_gicp"] = "small_gicp"
    reach_m: float = 40.0
    sampling_m: float = 0.3
    voxel_m: float = 0.5
    correspondence_m: float = 1.0
    iterations: int = 20
    least_overlap_ratio: float = 0.3
    max_correction_m: float = 0.3
    max_correction_rad: float = 0.035
    pull_ratio: float = 0.05
    horizon_frames: int = 300


@dataclass(frozen=True)
class LabelParameters:
    """All parameters that affect a label; recorded with every label set.

    - `body_clearance_m`: objects between this height above ground and the LiDAR in the robot's path are removed,
      because the robot's body passed there
    - `dynamic.every_frame`, `carve.every_frame`: for a LiDAR at 10 Hz; at other rates the same time interval is used
    - `confidence`: adds D² and, in profile `field`, the probability of the label to every frame; changes no label
    - `refinement`: None if the given poses are used
    - `grids`: the map covers all grids; labels are cropped at the first, optionally also at the others
    """

    profile: Profile = "paper"
    selection: SelectionParameters = field(default_factory=SelectionParameters)
    surface: SurfaceParameters = field(default_factory=SurfaceParameters)
    tiling: TilingParameters = field(default_factory=TilingParameters)
    dynamic: DynamicParameters = field(default_factory=DynamicParameters)
    carve: CarveParameters = field(default_factory=CarveParameters)
    terrain: TerrainParameters = field(default_factory=TerrainParameters)
    reference: ReferenceParameters = field(default_factory=ReferenceParameters)
    footprint_band_m: float = BAND_M
    body_clearance_m: float = 0.3
    local_ground_radius_m: float = 0.5
    confidence: bool = False
    refinement: RefinementParameters | None = None
    grids: tuple[LabelGrid, ...] = (PAPER,)

    @property
    def grid(self) -> LabelGrid:
        """The grid at which labels are cropped."""
        return self.grids[0]

    @property
    def rule(self) -> ProfileRule:
        """The rule by which its profile judges a voxel."""
        return RULES[self.profile]

    @property
    def core_m(self) -> float:
        """Side of the kept part of a cube's surface; cores tile the plane."""
        return self.tiling.cube_cells * self.surface.width_m - 2 * self.tiling.halo_m


# Driven voxels beyond this many scaled median deviations are excluded from the reference (truth.md's table: 3.5).
CLEAN_MADS = 3.5
# Scatter of features on one kind of ground due to errors of ranges, poses and single vertices: m, rad, log m².
MEASUREMENT_NOISE = (0.06, 0.09, 0.7)
REFERENCES: Mapping[Profile, ReferenceParameters] = {
    "paper": ReferenceParameters(),
    "local": ReferenceParameters(floor_voxels=200, clean_mads=CLEAN_MADS),
    "field": ReferenceParameters(clean_mads=CLEAN_MADS, noise=MEASUREMENT_NOISE),
}


def parameters_for(profile: Profile) -> LabelParameters:
    """Return the default parameters of a profile (`stone.labels.profiles`)."""
    return LabelParameters(profile=profile, reference=REFERENCES[profile])


def other_profile_of(profile: Profile) -> Profile:
    """Return the profile for comparison: the paper's, or the default if the label set has the paper's."""
    return DEFAULT_PROFILE if profile == "paper" else "paper"


def other_profile(parameters: LabelParameters) -> LabelParameters:
    """Return the same parameters with the other profile and its reference; α stays as chosen."""
    profile = other_profile_of(parameters.profile)
    reference = replace(REFERENCES[profile], alpha=parameters.reference.alpha)
    return replace(parameters, profile=profile, reference=reference)


def chosen_parameters(
    profile: str, choices: Mapping[str, float], grids: tuple[LabelGrid, ...] = (PAPER,)
) -> LabelParameters:
    """Return the parameters of a profile with choices by dotted name, for these grids. Raises `bad_parameter`."""
    check_choices(profile, choices)
    parameters = replace(parameters_for(cast("Profile", profile)), grids=grids)
    for name, value in choices.items():
        parameters = _replace_leaf(parameters, name.split("."), value)
    return parameters


def _replace_leaf(value: Any, path: list[str], leaf: float) -> Any:
    """Return the frozen value with the leaf at this path replaced."""
    name, *rest = path
    return replace(value, **{name: _replace_leaf(getattr(value, name), rest, leaf) if rest else leaf})
