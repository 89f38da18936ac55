"""The release layout, read without the devkit: names, bytes, poses; the same bytes every time."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.labeler.exports.nuscenes.layout import write_nuscenes
from services.labeler.exports.nuscenes.samples import RADAR_RECORD, lidar_bytes, radar_bytes
from services.labeler.exports.nuscenes.tables import token_of
from stone.sensors.samples import LidarSample, RadarSample
from tests.services.labeler.exports.made import Labelled, files_of, unheard


@pytest.fixture(scope="module")
def out(drive: Labelled, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("nuscenes")
    write_nuscenes(drive.source(), folder, unheard)
    return folder


def test_the_scene_says_how_well_its_labels_hold(drive: Labelled, tmp_path: Path) -> None:
    found = {"code": "LAB-605", "severity": "warning", "topic": "", "message": "so"}
    report = {**drive.report, "held_out": {"recall": 0.97, "judged_m": 75.4}, "findings": [found]}
    write_nuscenes(replace(drive.source(), report=report), tmp_path, unheard)
    quality = {"held_out_recall": 0.97, "held_out_m": 75.4, "gravest": {"code": "LAB-605", "harm": "wrong"}}
    assert [scene["quality"] for scene in rows(tmp_path, "scene")] == [quality]


def rows(out: Path, table: str) -> list[dict[str, Any]]:
    read: list[dict[str, Any]] = json.loads((out / "v1.0-trainval" / f"{table}.json").read_text())
    return read


def radar_sample(points: Any, rates: Any) -> RadarSample:
    """Detections whose rate over the ground is 1 m/s more than measured."""
    rcs = np.full(len(points), 5, np.float32)
    return RadarSample(0, points, points, rates, rates + 1, rcs)


def radar_rows(content: bytes) -> Any:
    header, _, body = content.partition(b"DATA binary\n")
    assert body[-1:] == b"\n"
    fields = dict(line.split(" ", 1) for line in header.decode().splitlines()[1:])
    sizes, kinds = fields["SIZE"].split(), fields["TYPE"].split()
    letters = [("f" if kind == "F" else "i") + size for kind, size in zip(kinds, sizes, strict=True)]
    record = np.dtype(list(zip(fields["FIELDS"].split(), [f"<{letter}" for letter in letters], strict=True)))
    assert len(record.names or ()) == 18
    read = np.frombuffer(body[:-1], record)
    assert len(read) == int(fields["WIDTH"]) == int(fields["POINTS"])
    return read


def test_file_names_say_log_channel_and_microsecond(out: Path, drive: Labelled) -> None:
    frames = drive.source().sequence.frames
    begun = datetime.fromtimestamp(int(frames.stamps_ns[0]) // 10**9, UTC)
    named = re.compile(r"samples/([A-Z_]+)/(n001-\d{4}(?:-\d\d){5}\+0000)__\1__(\d{16})\.(jpg|pcd\.bin|pcd)")
    for row in rows(out, "sample_data"):
        found = named.fullmatch(row["filename"])
        assert found is not None, row["filename"]
        assert found[2] == begun.strftime("n001-%Y-%m-%d-%H-%M-%S+0000")
        assert int(found[3]) == row["timestamp"]
        assert (out / row["filename"]).is_file()
    named_files = {row["filename"] for row in rows(out, "sample_data")}
    assert {name for name in files_of(out) if name.startswith("samples/")} == named_files


def test_a_sample_is_a_frame_and_its_labels_lie_under_its_token(out: Path, drive: Labelled) -> None:
    source = drive.source()
    tokens = source.sequence.frames.tokens
    assert tuple(row["token"] for row in rows(out, "sample")) == tokens
    for index, token in enumerate(tokens):
        assert (out / "gts" / "drive" / token / "labels.npz").read_bytes() == source.labels(index)


def test_sweeps_hold_points_intensity_and_ring(out: Path, drive: Labelled) -> None:
    source = drive.source()
    sweeps = [row for row in rows(out, "sample_data") if "LIDAR_TOP" in row["filename"]]
    for index, row in enumerate(sweeps):
        read, sample = np.fromfile(out / row["filename"], "<f4").reshape(-1, 5), source.samples.lidar(index)
        assert np.array_equal(read[:, :3], sample.points_lidar)
        assert np.array_equal(read[:, 3], sample.intensity)
        assert np.array_equal(read[:, 4], sample.ring)
        assert len(np.unique(sample.ring)) > 8
        assert sample.intensity.max() > 0


def test_pictures_are_the_recorded_bytes(out: Path, drive: Labelled) -> None:
    source = drive.source()
    front = [row for row in rows(out, "sample_data") if "__CAM_FRONT__" in row["filename"]]
    picture = source.samples.camera("CAM_FRONT", 0)
    assert picture is not None
    assert (out / front[0]["filename"]).read_bytes() == picture.content
    assert picture.content[:3] == b"\xff\xd8\xff"
    assert front[0]["timestamp"] == picture.stamp_ns // 1000


def test_every_datum_has_the_pose_of_its_own_time(out: Path, drive: Labelled) -> None:
    poses = {row["token"]: row for row in rows(out, "ego_pose")}
    assert {row["timestamp"] for row in rows(out, "sample_data")} == {pose["timestamp"] for pose in poses.values()}
    for row in rows(out, "sample_data"):
        assert poses[row["ego_pose_token"]]["timestamp"] == row["timestamp"]
        assert np.linalg.norm(poses[row["ego_pose_token"]]["rotation"]) == pytest.approx(1)
    log, frames = rows(out, "log")[0], drive.source().sequence.frames
    lidar = [row for row in rows(out, "sample_data") if "LIDAR_TOP" in row["filename"]]
    for row, pose in zip(lidar, frames.map_from_ego.translation_m, strict=True):
        shifted = np.array(poses[row["ego_pose_token"]]["translation"]) - np.array(log["global_from_map_m"])
        np.testing.assert_allclose(shifted, pose, atol=1e-9)
    assert min(min(pose["translation"][:2]) for pose in poses.values()) > 0


def test_points_that_are_not_finite_are_left_out_of_a_sweep() -> None:
    points = np.array([[1, 2, 3], [np.nan, 0, 0], [4, 5, 6]], np.float32)
    sample = LidarSample(points, np.array([7, 8, np.inf], np.float32), np.array([1, 2, 3], np.uint16))
    assert np.frombuffer(lidar_bytes(sample), "<f4").tolist() == [1, 2, 3, 7, 1]


@given(st.lists(st.tuples(st.floats(1, 200), st.floats(-3, 3), st.floats(-0.5, 0.5), st.floats(-60, 60)), max_size=30))
def test_radar_velocities_are_the_rate_along_the_ray(seen: list[tuple[float, float, float, float]]) -> None:
    r, azimuth, elevation, rate = np.array(seen, np.float64).reshape(-1, 4).T
    level = np.cos(elevation)
    points = (r * np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])).T
    read = radar_rows(radar_bytes(radar_sample(points, rate)))
    if not seen:
        assert np.isnan(read["x"]).all()
        return
    np.testing.assert_allclose(np.stack([read["x"], read["y"], read["z"]], axis=1), points, rtol=1e-5, atol=1e-4)
    np.testing.assert_allclose(np.hypot(read["vx"], read["vy"]), np.abs(rate) * level, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(
        np.hypot(read["vx_comp"], read["vy_comp"]), np.abs(rate + 1) * level, rtol=1e-4, atol=1e-4
    )


def test_detections_without_motion_or_place_are_left_out() -> None:
    points = np.array([[10.0, 0, 0], [0, 0, 0], [np.nan, 1, 1], [20.0, 1, 1]])
    read = radar_rows(radar_bytes(radar_sample(points, np.array([1.0, 1.0, 1.0, np.nan]))))
    assert read["x"].tolist() == [10.0]
    assert read.dtype == RADAR_RECORD


def test_tokens_are_of_their_facts_alone() -> None:
    assert token_of("sample_data", "ab", "CAM_FRONT") == token_of("sample_data", "ab", "CAM_FRONT")
    assert token_of("a", "bc") != token_of("ab", "c")
    assert re.fullmatch("[0-9a-f]{32}", token_of("scene", "drive"))
