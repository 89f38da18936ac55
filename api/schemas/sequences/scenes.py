"""Scenes over the wire: the grid and frames of a labelled sequence, and the files that show its map."""

from typing import Literal

from api.schemas.base import ID_EXAMPLE, Answer, example
from api.schemas.grids import GridItem


class ReferenceItem(Answer):
    """The Gaussian of the driven ground; a voxel whose D² exceeds `d2_limit` is not potentially traversable."""

    model_config = example(
        mean=[1.08, 0.15, -10.3],
        covariance=[[1.2, 0.0, -0.1], [0.0, 0.006, 0.004], [-0.1, 0.004, 0.61]],
        d2_limit=7.814728,
        features=["elevation_m", "slope_rad", "roughness"],
    )

    mean: list[float]
    covariance: list[list[float]]
    d2_limit: float
    features: list[str]


class SceneFrames(Answer):
    """The labelled frames in the order of time; a pose is (tx, ty, tz, qw, qx, qy, qz), a stamp too long for a double.

    Frame `i` is `tokens[i]`, taken at `stamps_ns[i]` where the robot stood at `map_from_ego[i]`.
    """

    model_config = example(
        tokens=[ID_EXAMPLE], stamps_ns=["1777800000000000000"], map_from_ego=[[0.0, 0.0, 0.3, 1.0, 0.0, 0.0, 0.0]]
    )

    tokens: list[str]
    stamps_ns: list[str]
    map_from_ego: list[list[float]]


class TileItem(Answer):
    """A tile of the labelled map, at `scene/tiles/{name}`; its voxels lie between `min_m` and `max_m` in the map."""

    model_config = example(name="0_-1", min_m=[0.0, -48.0, -0.4], max_m=[48.0, 0.0, 6.2], voxels=61204, bytes=702113)

    name: str
    min_m: list[float]
    max_m: list[float]
    voxels: int
    bytes: int


class MeshItem(Answer):
    """The thinned surface of the tile of this name, at `scene/meshes/{name}`."""

    model_config = example(name="0_-1", triangles=38112, bytes=410230)

    name: str
    triangles: int
    bytes: int


class MountedSensorItem(Answer):
    """A sensor of the rig by its channel; its pose in the ego frame is (tx, ty, tz, qw, qx, qy, qz)."""

    model_config = example(channel="RADAR_LEFT", kind="radar", ego_from_sensor=[0.1, 0.4, 0.6, 0.71, 0.0, 0.0, 0.71])

    channel: str
    kind: str
    ego_from_sensor: list[float]


class PlaybackItem(Answer):
    """Whether there are pictures and sweeps beside the voxels, and which cameras have pictures.

    `has_rays`: `scene/cameras` has the poses and rays of the pictures; playbacks of earlier releases have none.
    `sensors` are those of the calibration, empty in playbacks of earlier releases, which have no radars either.
    """

    model_config = example(
        state="ready", cameras=["CAM_FRONT", "CAM_BACK"], has_clouds=True, has_rays=True, has_radars=True
    )

    export_id: str | None
    state: Literal["none", "making", "ready"]
    cameras: list[str]
    has_clouds: bool
    has_rays: bool
    sensors: list[MountedSensorItem]
    has_radars: bool


class SceneDetail(Answer):
    """A labelled sequence as the viewer shows it; `label_set_id` as `v` of its files makes their addresses lasting.

    `reference` is null of labels that were imported from a published dataset: the features of their voxels are NaN.
    `has_confidence`: the confidence of some voxel is known. `grid` is that of the frames; the tiles are of a map whose
    voxels have the side `map_voxel_m`.
    """

    model_config = example(
        name="n-forest-07", profile="field", map_voxel_m=0.2, footprint_m=[1.06, 0.85], has_confidence=True
    )

    sequence_id: str
    label_set_id: str
    name: str
    profile: str
    grid: GridItem
    map_voxel_m: float
    footprint_m: list[float]
    reference: ReferenceItem | None
    has_confidence: bool
    frames: SceneFrames
    tiles: list[TileItem]
    meshes: list[MeshItem]
    playback: PlaybackItem
