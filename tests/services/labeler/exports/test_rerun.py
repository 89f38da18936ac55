"""The recording for Rerun, read back by Rerun's own reader."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from rerun.chunk import Chunk, RrdReader

from services.labeler.exports.meshes import open_mesh
from services.labeler.exports.rerun import write_rerun
from services.labeler.exports.source import LabelledSequence
from stone.labels.class_colours import CLASS_NAME, CLASS_RGB
from stone.labels.voxels import VOXEL_M
from stone_base.label_grid import PAPER
from tests.services.labeler.exports.made import Labelled

FRAME = 5
LIDAR = "/map/ego/LIDAR"


@dataclass(frozen=True)
class Written:
    path: Path
    source: LabelledSequence
    chunks: list[Chunk]

    def rows(self, entity: str, component: str) -> list[tuple[dict[str, Any], Any]]:
        """Of every chunk of the entity that has the component: its times, and its one row."""
        found = []
        for chunk in self.chunks:
            batch = chunk.to_record_batch()
            if chunk.entity_path == entity and component in batch.schema.names:
                assert batch.num_rows == 1
                times = {name: batch.column(name).cast(pa.int64())[0].as_py() for name in chunk.timeline_names}
                found.append((times, batch.column(component)[0].values))
        return found

    def at(self, entity: str, component: str, index: int = FRAME) -> Any:
        return next(values for times, values in self.rows(entity, component) if times["frame"] == index)


def chunks_of(path: Path) -> list[Chunk]:
    reader = RrdReader(path)
    (recording,) = reader.recordings()
    return list(reader.stream(store=recording))


@pytest.fixture(scope="module")
def written(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Written:
    folder, source = tmp_path_factory.mktemp("rerun"), drive.source()
    write_rerun(source, folder)
    (path,) = folder.iterdir()
    return Written(path, source, chunks_of(path))


def vectors(values: pa.Array, size: int = 3) -> np.ndarray[Any, Any]:
    return np.asarray(values.flatten()).reshape(-1, size)


def rgb_of(packed: pa.Array) -> np.ndarray[Any, Any]:
    colours = np.asarray(packed)
    return np.stack([colours >> 24, colours >> 16 & 255, colours >> 8 & 255], axis=1)


def test_the_recording_is_named_and_comes_with_the_view_it_opens_in(written):
    reader = RrdReader(written.path)
    (recording,), (view,) = reader.recordings(), reader.blueprints()
    assert (recording.application_id, recording.recording_id) == ("stone", "drive")
    assert view.application_id == "stone"
    shown = {
        chunk.to_record_batch().column("ViewBlueprint:space_origin")[0].values[0].as_py()
        for chunk in reader.stream(store=view)
        if "ViewBlueprint:space_origin" in chunk.to_record_batch().schema.names
    }
    cameras = {f"{LIDAR}/{mount.name}" for mount in written.source.sequence.calibration.of_kind("camera")}
    assert shown == {"/map/ego", *cameras}
    assert len(cameras) == 6


def test_every_sensor_of_the_rig_has_its_entity_and_both_timelines(written):
    calibration, frames = written.source.sequence.calibration, written.source.sequence.frames
    entities = {chunk.entity_path for chunk in written.chunks if not chunk.entity_path.startswith("/__properties")}
    sensors = {f"{LIDAR}/{m.name}" for kind in ("camera", "radar") for m in calibration.of_kind(kind)}
    assert entities == {"/map", "/map/track", "/map/mesh/0", "/map/ego", "/map/ego/labels", LIDAR} | sensors
    for entity, component in (
        ("/map/ego", "Transform3D:translation"),
        ("/map/ego/labels", "Boxes3D:centers"),
        (LIDAR, "Points3D:positions"),
    ):
        times = [times for times, _ in written.rows(entity, component)]
        assert [t["frame"] for t in times] == list(range(len(frames)))
        assert [t["stamp"] for t in times] == frames.stamps_ns.tolist()
    for mount in calibration.of_kind("camera"):
        taken = frames.associations[mount.name]
        times = [times for times, _ in written.rows(f"{LIDAR}/{mount.name}", "EncodedImage:blob")]
        kept = taken.message_index >= 0
        assert [t["frame"] for t in times] == np.flatnonzero(kept).tolist()
        assert [t["stamp"] for t in times] == (frames.stamps_ns + taken.dt_ns)[kept].tolist()


def test_the_boxes_are_the_labelled_voxels_in_the_colours_of_their_class(written):
    semantics = written.source.grids(FRAME)["semantics"]
    centres = vectors(written.at("/map/ego/labels", "Boxes3D:centers"))
    classes = np.asarray(written.at("/map/ego/labels", "Boxes3D:class_ids"))
    indices = np.round((centres - np.array(PAPER.min_m)) / VOXEL_M - 0.5).astype(int)
    shown = np.zeros_like(semantics)
    shown[tuple(indices.T)] = classes
    np.testing.assert_array_equal(shown, semantics)
    half = vectors(written.at("/map/ego/labels", "Boxes3D:half_sizes"))
    np.testing.assert_allclose(half, [[VOXEL_M / 2] * 3])
    ((_, context),) = written.rows("/map/ego/labels", "AnnotationContext:context")
    infos = [entry["class_description"]["info"] for entry in context.to_pylist()[0]]
    for info in infos:
        r, g, b = CLASS_RGB[info["id"]]
        assert (info["label"], info["color"]) == (CLASS_NAME[info["id"]], r << 24 | g << 16 | b << 8 | 255)
    assert {info["id"] for info in infos} == set(CLASS_RGB)


def test_points_pictures_and_poses_are_those_of_the_frame(written):
    source, frames = written.source, written.source.sequence.frames
    sample = source.samples.lidar(FRAME)
    np.testing.assert_array_equal(vectors(written.at(LIDAR, "Points3D:positions")), sample.points_lidar)
    brightness = rgb_of(written.at(LIDAR, "Points3D:colors"))[:, 0]
    assert (np.diff(brightness[np.argsort(sample.intensity)].astype(int)) >= 0).all()
    picture = source.samples.camera("CAM_FRONT", FRAME)
    blob = written.at(f"{LIDAR}/CAM_FRONT", "EncodedImage:blob")
    assert np.asarray(blob.flatten()).tobytes() == picture.content
    pose = frames.map_from_ego[FRAME]
    np.testing.assert_allclose(
        vectors(written.at("/map/ego", "Transform3D:translation"))[0], pose.translation_m, atol=1e-4
    )
    xyzw = vectors(written.at("/map/ego", "Transform3D:quaternion"), 4)[0]
    np.testing.assert_allclose(np.roll(xyzw, 1), pose.wxyz, atol=1e-6)


def test_the_lens_and_the_place_of_a_camera_are_the_calibrations(written):
    mount = written.source.sequence.calibration.mount("CAM_BACK")
    entity = f"{LIDAR}/CAM_BACK"
    ((times, translation),) = written.rows(entity, "Transform3D:translation")
    assert times == {}
    np.testing.assert_allclose(vectors(translation)[0], mount.lidar_from_sensor.translation_m, atol=1e-6)
    ((_, matrix),) = written.rows(entity, "Pinhole:image_from_camera")
    lens, columns = mount.intrinsics, vectors(matrix, 9)[0].reshape(3, 3)  # column after column
    np.testing.assert_allclose(columns.T @ [1, 2, 4], [lens.fx_px + 4 * lens.cx_px, 2 * lens.fy_px + 4 * lens.cy_px, 4])


def test_radar_detections_keep_their_rates_and_what_moves_has_a_colour(written):
    scan = written.source.samples.radar("RADAR_LEFT", FRAME)
    kept = np.isfinite(scan.points_lidar).all(axis=1)
    entity = f"{LIDAR}/RADAR_LEFT"
    np.testing.assert_allclose(vectors(written.at(entity, "Points3D:positions")), scan.points_lidar[kept], rtol=1e-6)
    rate = np.asarray(written.at(entity, "range_rate_m_s"))
    np.testing.assert_allclose(rate, scan.range_rate_m_s[kept].astype(np.float32))
    colours = rgb_of(written.at(entity, "Points3D:colors")).astype(int)
    receding = scan.ground_rate_m_s[kept] > 0.1
    approaching = scan.ground_rate_m_s[kept] < -0.1
    assert (colours[receding, 0] > colours[receding, 2]).all()
    assert (colours[approaching, 2] > colours[approaching, 0]).all()


def test_the_mesh_and_the_track_are_whole_and_hold_for_all_times(written):
    mesh, triangles = open_mesh(written.source.mesh), []
    for entity in sorted({c.entity_path for c in written.chunks if c.entity_path.startswith("/map/mesh")}):
        ((times, corners),) = written.rows(entity, "Mesh3D:triangle_indices")
        ((_, positions),) = written.rows(entity, "Mesh3D:vertex_positions")
        ((_, normals),) = written.rows(entity, "Mesh3D:vertex_normals")
        assert times == {}
        triangles.append(vectors(positions)[vectors(corners)])
        np.testing.assert_allclose(np.linalg.norm(vectors(normals), axis=1), 1.0, atol=1e-5)
    np.testing.assert_array_equal(np.concatenate(triangles), mesh.vertices["xyz"][mesh.faces["indices"]])
    ((_, strips),) = written.rows("/map/track", "LineStrips3D:strips")
    track = vectors(strips.flatten())
    np.testing.assert_allclose(track, written.source.sequence.frames.map_from_ego.translation_m, atol=1e-4)
