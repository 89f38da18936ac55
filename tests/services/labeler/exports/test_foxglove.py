"""The MCAP for Foxglove, read back by the mcap package and by a plain protobuf reader of our own."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader

from services.labeler.exports.foxglove import write_foxglove
from services.labeler.exports.meshes import open_mesh
from services.labeler.exports.source import LabelledSequence
from stone.geometry.se3 import SE3
from stone.labels.class_colours import CLASS_RGB
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER
from tests.services.labeler.exports.made import Labelled
from tests.services.labeler.exports.protobuf_wire import decoded, messages_of

PUBLISHED = Path(__file__).with_name("foxglove_schemas.txt")
FRAME = 5
TOPICS = {
    "/tf": "foxglove.FrameTransforms",
    "/labels": "foxglove.VoxelGrid",
    "/LIDAR": "foxglove.PointCloud",
    "/RADAR_LEFT": "foxglove.PointCloud",
    "/CAM_BACK/image": "foxglove.CompressedImage",
    "/CAM_BACK/calibration": "foxglove.CameraCalibration",
    "/track": "foxglove.PosesInFrame",
    "/map/mesh/0": "foxglove.SceneUpdate",
}


@dataclass(frozen=True)
class Written:
    """`logged` are (topic, schema name, log time, message) in the order of the file."""

    path: Path
    source: LabelledSequence
    logged: list[tuple[str, str, int, dict[str, Any]]]

    def of(self, topic: str, index: int = FRAME) -> dict[str, Any]:
        return [message for name, _, _, message in self.logged if name == topic][index]


@pytest.fixture(scope="module")
def written(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder = tmp_path_factory.mktemp("foxglove")
    source = drive.source()
    write_foxglove(source, folder)
    (path,) = folder.iterdir()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        known = {schema.name: messages_of(schema.data) for schema in reader.get_summary().schemas.values()}
        logged = [
            (channel.topic, schema.name, message.log_time, decoded(message.data, schema.name, known[schema.name]))
            for schema, channel, message in reader.iter_messages(log_time_order=False)
        ]
    return Written(path, source, logged)


def published() -> dict[str, set[str]]:
    """By message, its fields as the documentation of the schemas lists them."""
    found: dict[str, set[str]] = {}
    for line in PUBLISHED.read_text().splitlines():
        if line.startswith(" "):
            found[next(reversed(found))].add(line.strip())
        else:
            found[line] = set()
    return found


def stamp_of(message: dict[str, Any]) -> int:
    seconds: int = message["timestamp"]["seconds"]
    return seconds * 10**9 + int(message["timestamp"].get("nanos", 0))


def records_of(cloud: dict[str, Any]) -> np.ndarray[Any, Any]:
    """The data by the fields that come with it."""
    kinds = {1: "u1", 3: "<u2", 7: "<f4"}
    fields = {field["name"]: (kinds[field["type"]], field.get("offset", 0)) for field in cloud["fields"]}
    record = np.dtype(
        {
            "names": list(fields),
            "formats": [kind for kind, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": cloud.get("point_stride") or cloud["cell_stride"],
        }
    )
    return np.frombuffer(cloud["data"], record)


def pose_of(position: dict[str, float], orientation: dict[str, float]) -> SE3:
    wxyz = np.array([orientation.get(axis, 0.0) for axis in "wxyz"])
    return SE3.from_parts(wxyz, np.array([position.get(axis, 0.0) for axis in "xyz"]))


def test_every_schema_in_the_file_is_the_published_one(written):
    with written.path.open("rb") as file:
        schemas = make_reader(file).get_summary().schemas.values()
    assert {schema.name for schema in schemas} == set(TOPICS.values())
    for schema in schemas:
        assert schema.encoding == "protobuf"
        for name, fields in messages_of(schema.data).items():
            assert {str(field) for field in fields.values()} == published()[name], name


def test_the_file_is_indexed_in_zstd_chunks_and_holds_every_topic_of_every_frame(written):
    with written.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary.chunk_indexes
    assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
    frames = len(written.source.sequence.frames)
    counts = {summary.channels[key].topic: n for key, n in summary.statistics.channel_message_counts.items()}
    assert {topic: counts[topic] for topic in ("/tf", "/labels", "/LIDAR")} == dict.fromkeys(
        ("/tf", "/labels", "/LIDAR"), frames
    )
    assert {topic: name for topic, name, _, _ in written.logged if topic in TOPICS} == TOPICS
    for channel in ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT"):
        taken = (written.source.sequence.frames.associations[channel].message_index >= 0).sum()
        assert counts[f"/{channel}/image"] == counts[f"/{channel}/calibration"] == taken > 0
    assert counts["/track"] == counts["/map/mesh/0"] == 1


def test_log_times_are_the_stamps_in_the_messages(written):
    sequence = written.source.sequence
    for topic, _, log_time, message in written.logged:
        if "timestamp" in message:
            assert stamp_of(message) == log_time, topic
    assert [time for topic, _, time, _ in written.logged if topic == "/tf"] == sequence.frames.stamps_ns.tolist()
    taken = sequence.frames.associations["CAM_BACK"]
    seen = [time for topic, _, time, _ in written.logged if topic == "/CAM_BACK/image"]
    assert seen == (sequence.frames.stamps_ns + taken.dt_ns)[taken.message_index >= 0].tolist()


def test_every_voxel_has_the_colour_and_the_class_of_its_label_at_its_place(written):
    grid, semantics = written.of("/labels"), written.source.grids(FRAME)["semantics"]
    assert (grid["column_count"], grid["row_count"]) == PAPER.shape[:2]
    assert grid["frame_id"] == "ego"
    assert [grid["cell_size"][axis] for axis in "xyz"] == [VOXEL_M] * 3
    assert pose_of(**grid["pose"]).wxyz_xyz.tolist() == [1, 0, 0, 0, *PAPER.min_m]
    cells = records_of(grid)
    assert grid["row_stride"] == grid["cell_stride"] * grid["column_count"]
    assert grid["slice_stride"] == grid["row_stride"] * grid["row_count"]
    assert len(grid["data"]) == grid["slice_stride"] * PAPER.shape[2]
    # by the documentation's own formula: byte offset to place
    offsets = np.flatnonzero(cells["class"]) * grid["cell_stride"]
    z, y = offsets // grid["slice_stride"], offsets % grid["slice_stride"] // grid["row_stride"]
    x = offsets % grid["row_stride"] // grid["cell_stride"]
    shown = np.zeros(PAPER.shape, np.uint8)
    shown[x, y, z] = cells["class"][cells["class"] > 0]
    np.testing.assert_array_equal(shown, semantics)
    for kind, colour in CLASS_RGB.items():
        of_kind = cells[cells["class"] == kind]
        assert {tuple(c) for c in of_kind[["red", "green", "blue", "alpha"]].tolist()} == {(*colour, 255)}
    assert not cells["alpha"][cells["class"] == 0].any()


def test_a_cloud_holds_every_return_with_its_intensity_and_ring(written):
    cloud, sample = records_of(written.of("/LIDAR")), written.source.samples.lidar(FRAME)
    assert written.of("/LIDAR")["frame_id"] == "LIDAR"
    assert len(cloud) == len(sample.points_lidar) > 1000
    np.testing.assert_array_equal(np.stack([cloud[axis] for axis in "xyz"], axis=1), sample.points_lidar)
    np.testing.assert_array_equal(cloud["intensity"], sample.intensity)
    np.testing.assert_array_equal(cloud["ring"], sample.ring)
    assert len(set(cloud["ring"].tolist())) == 16


def test_a_radar_scan_holds_both_rates_and_the_cross_section(written):
    scan = written.source.samples.radar("RADAR_LEFT", FRAME)
    message = next(m for topic, _, time, m in written.logged if (topic, time) == ("/RADAR_LEFT", scan.stamp_ns))
    cloud = records_of(message)
    assert message["frame_id"] == "RADAR_LEFT"
    assert len(cloud) == len(scan.points_radar) > 0
    np.testing.assert_allclose(np.stack([cloud[axis] for axis in "xyz"], axis=1), scan.points_radar, rtol=1e-6)
    for name, values in (("range_rate", scan.range_rate_m_s), ("ground_rate", scan.ground_rate_m_s)):
        np.testing.assert_array_equal(cloud[name], values.astype(np.float32))
    np.testing.assert_array_equal(cloud["rcs"], scan.rcs_db)


def test_transforms_compose_to_where_each_sensor_was(written):
    sequence = written.source.sequence
    tree = {
        link["child_frame_id"]: (link["parent_frame_id"], pose_of(link["translation"], link["rotation"]))
        for link in written.of("/tf")["transforms"]
    }
    map_from_lidar = sequence.frames.map_from_ego[FRAME] @ sequence.calibration.ego_from_lidar
    for mount in sequence.calibration.mounts:
        frame, map_from_sensor = mount.name, SE3.identity()
        while frame != "map":
            frame, parent_from_child = tree[frame]
            map_from_sensor = parent_from_child @ map_from_sensor
        wanted = (map_from_lidar @ mount.lidar_from_sensor).as_matrix()
        np.testing.assert_allclose(map_from_sensor.as_matrix(), wanted, atol=1e-9)


def test_pictures_are_the_recorded_ones_and_come_with_their_lens(written):
    sample = written.source.samples.camera("CAM_BACK", FRAME)
    lens = written.source.sequence.calibration.mount("CAM_BACK").intrinsics
    shown = next(m for topic, _, time, m in written.logged if (topic, time) == ("/CAM_BACK/image", sample.stamp_ns))
    assert (shown["data"], shown["format"], shown["frame_id"]) == (sample.content, "jpeg", "CAM_BACK")
    calibration = written.of("/CAM_BACK/calibration", 0)
    assert (calibration["width"], calibration["height"]) == (lens.width_px, lens.height_px)
    assert calibration["K"] == [lens.fx_px, 0, lens.cx_px, 0, lens.fy_px, lens.cy_px, 0, 0, 1]
    assert calibration["D"] == list(lens.distortion or (0.0,) * 5)
    assert len(calibration["R"]), len(calibration["P"]) == (9, 12)


def test_the_track_and_the_mesh_are_whole(written):
    poses = written.source.sequence.frames.map_from_ego
    shown = np.stack([pose_of(**pose).wxyz_xyz for pose in written.of("/track", 0)["poses"]])
    np.testing.assert_allclose(shown, poses.wxyz_xyz, atol=1e-12)
    mesh, triangles = open_mesh(written.source.mesh), []
    parts = [message for topic, _, _, message in written.logged if topic.startswith("/map/mesh/")]
    for part in parts:
        (entity,) = part["entities"]
        (shape,) = entity["triangles"]
        points = np.array([[point.get(axis, 0.0) for axis in "xyz"] for point in shape["points"]])
        assert len(shape["colors"]) == len(points)
        triangles.append(points[np.array(shape["indices"]).reshape(-1, 3)])
    np.testing.assert_array_equal(np.concatenate(triangles), mesh.vertices["xyz"][mesh.faces["indices"]])


def test_the_same_sequence_gives_the_same_bytes_and_a_silent_camera_no_message(written, drive, tmp_path):
    write_foxglove(drive.source(), tmp_path)
    assert (tmp_path / written.path.name).read_bytes() == written.path.read_bytes()
    source = drive.source()
    silenced = replace(source, samples=_WithoutCameras(source.samples))
    steps: list[tuple[int, int]] = []
    (tmp_path / "silent").mkdir()
    write_foxglove(silenced, tmp_path / "silent", lambda *done: steps.append(done))
    with (tmp_path / "silent" / written.path.name).open("rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    assert topics == {name for name, _, _, _ in written.logged if not name.startswith("/CAM")}
    assert steps == [(done, steps[-1][1]) for done in range(steps[-1][1] + 1)]


@dataclass(frozen=True)
class _WithoutCameras:
    samples: Any

    def camera(self, channel: str, index: int) -> None:
        return None

    def __getattr__(self, name: str) -> Any:
        return getattr(self.samples, name)
