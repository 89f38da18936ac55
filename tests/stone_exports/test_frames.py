"""Frames of exports: every datum with its time, pose and mount; tables that lie are refused, by name."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stone_exports.files import DamagedExportError, FolderFiles
from stone_exports.frames import ExportedFrame, frames_in
from testing.worlds.small_export import (
    CAMERAS,
    EXPOSURE_US,
    FOCAL_PX,
    LIDAR_M,
    PICTURE_PX,
    START_US,
    STEP_US,
    global_from_ego,
    write_table,
)
from tests.stone_exports.conftest import RIG

Rows = list[dict[str, Any]]


def frames(folder: Path) -> tuple[ExportedFrame, ...]:
    return frames_in(FolderFiles(folder))


def rewritten(folder: Path, table: str, change: Callable[[Rows], object]) -> Path:
    """The export with other rows in a table."""
    rows = json.loads((folder / "v1.0-trainval" / f"{table}.json").read_text())
    change(rows)
    write_table(folder, table, rows)
    return folder


def test_frames_come_by_time_with_all_their_sensors(rig: Path) -> None:
    found = frames(rig)
    assert tuple(frame.token for frame in found) == RIG.tokens
    assert [frame.stamp_us for frame in found] == [START_US, START_US + STEP_US]
    assert {frame.sequence for frame in found} == {"meadow"}
    assert all(set(frame.data) == {"LIDAR_TOP", *CAMERAS, "RADAR_FRONT"} for frame in found)
    assert [datum.sensor.channel for datum in found[0].of_modality("camera")] == sorted(CAMERAS)


def test_a_datum_has_the_pose_of_its_own_time_and_its_mount(rig: Path) -> None:
    picture = frames(rig)[1].data["CAM_FRONT"]
    assert picture.stamp_us == START_US + STEP_US + EXPOSURE_US
    np.testing.assert_allclose(picture.global_from_ego.as_matrix(), global_from_ego(picture.stamp_us).as_matrix())
    np.testing.assert_allclose(picture.sensor.ego_from_sensor.translation_m, LIDAR_M)


def test_a_camera_has_its_lens(rig: Path) -> None:
    lens = frames(rig)[0].data["CAM_BACK"].sensor.intrinsics
    assert lens is not None
    assert (lens.model, lens.width_px, lens.height_px) == ("plumb_bob", *PICTURE_PX)
    assert (lens.fx_px, lens.cx_px, lens.distortion) == (FOCAL_PX, 31.5, RIG.lens[1])


def test_labels_are_those_of_the_frame_where_there_are_some(copied: Path) -> None:
    first, second = RIG.tokens
    (copied / "gts" / "meadow" / second / "labels.npz").unlink()
    with_labels, without = frames(copied)
    assert with_labels.labels is not None
    assert with_labels.labels.path == copied / "gts" / "meadow" / first / "labels.npz"
    assert without.labels is None


def test_order_of_rows_does_not_matter(rig: Path, copied: Path) -> None:
    for table in ("sample", "sample_data", "ego_pose", "calibrated_sensor"):
        rewritten(copied, table, list.reverse)
    assert [frame.token for frame in frames(copied)] == [frame.token for frame in frames(rig)]


def test_what_is_no_key_frame_or_of_no_known_sensor_is_left(copied: Path) -> None:
    def change(rows: Rows) -> None:
        of(rows, "CAM_FRONT").update(is_key_frame=False)
        of(rows, "CAM_BACK").update(calibrated_sensor_token="another rig's")

    rewritten(copied, "sample_data", change)
    assert set(frames(copied)[0].data) == {"LIDAR_TOP", *CAMERAS, "RADAR_FRONT"} - {"CAM_FRONT", "CAM_BACK"}


def test_a_frame_without_a_sweep_is_none(copied: Path) -> None:
    rewritten(copied, "sample_data", lambda rows: rows.remove(of(rows, "LIDAR_TOP")))
    assert [frame.token for frame in frames(copied)] == [RIG.tokens[1]]


def of(rows: Rows, channel: str) -> dict[str, Any]:
    """The first row of this channel, in whichever table."""
    return next(row for row in rows if f"/{channel}/" in row.get("filename", "") or row["token"] == f"mount-{channel}")


ATTACKS: dict[str, tuple[str, Callable[[Rows], object], str]] = {
    "no pose": ("sample_data", lambda rows: of(rows, "LIDAR_TOP").update(ego_pose_token="x"), "no pose of 'samples/L"),
    "no file": ("sample_data", lambda rows: of(rows, "CAM_FRONT").update(filename="samples/a.jpg"), "no file of"),
    "a file elsewhere": ("sample_data", lambda rows: of(rows, "CAM_FRONT").update(filename="../../etc/x"), "no file"),
    "a stamp of text": ("sample_data", lambda rows: of(rows, "LIDAR_TOP").update(timestamp="now"), "a number of"),
    "a stamp before 1970": ("sample", lambda rows: rows[0].update(timestamp=-1), "not a number of microseconds"),
    "a stamp of 2^62": ("sample", lambda rows: rows[0].update(timestamp=1 << 62), "not a number of microseconds"),
    "a stamp in seconds": ("sample", lambda rows: rows[0].update(timestamp=1.7e9), "not a number of microseconds"),
    "a pose that scales": ("ego_pose", lambda rows: rows[0].update(rotation=[2, 0, 0, 0]), "not a pose"),
    "a pose far away": ("ego_pose", lambda rows: rows[0].update(translation=[1e8, 0, 0]), "not a pose"),
    "a pose that is no number": ("ego_pose", lambda rows: rows[0].update(translation=[float("nan")] * 3), "not a pose"),
    "a frame of no sequence": ("sample", lambda rows: rows[0].update(scene_token="x"), "belongs to no sequence"),
    "a token that is none": ("sample", lambda rows: rows[0].update(token="../x"), "not a frame token"),
    "a sequence above": ("scene", lambda rows: rows[0].update(name="../.."), "cannot be the name of a sequence"),
    "a mount of nothing": ("calibrated_sensor", lambda rows: rows[0].update(sensor_token="x"), "does not exist"),
    "a mount on the moon": ("calibrated_sensor", lambda rows: rows[0].update(translation=[0, 0, 4e8]), "not a pose"),
}  # fmt: skip


@pytest.mark.parametrize("attack", ATTACKS)
def test_tables_that_lie_are_refused(copied: Path, attack: str) -> None:
    table, change, why = ATTACKS[attack]
    with pytest.raises(DamagedExportError, match=why) as refused:
        frames(rewritten(copied, table, change))
    assert f"v1.0-trainval/{table}.json" in str(refused.value)


LENSES: dict[str, tuple[dict[str, Any], str]] = {
    "no matrix": ({"camera_intrinsic": []}, "matrix or model of a camera is not valid"),
    "a matrix of text": ({"camera_intrinsic": [["a"]]}, "matrix or model of a camera is not valid"),
    "a focal length of zero": (
        {"camera_intrinsic": [[0, 0, 1], [0, 1, 1], [0, 0, 1]]},
        "matrix or model of a camera is not valid",
    ),
    "a centre that is no number": ({"camera_intrinsic": [[1, 0, float("nan")], [0, 1, 1], [0, 0, 1]]}, "is not valid"),
    "a model that is none": ({"camera_model": "omnidirectional"}, "matrix or model of a camera is not valid"),
    "a model of a list": ({"camera_model": ["pinhole"]}, "matrix or model of a camera is not valid"),
    "four coefficients": ({"camera_distortion": [0.1, 0, 0, 0]}, "a plumb_bob camera has 4 coefficients .* are 5"),
    "a pinhole that bends": ({"camera_model": "pinhole"}, "a pinhole camera has 5 coefficients .* are 0"),
    "too few of eight": ({"camera_model": "rational_polynomial"}, "has 5 coefficients .* are 8"),
    "too many of four": ({"camera_model": "equidistant"}, "has 5 coefficients .* are 4"),
    "endless coefficients": ({"camera_distortion": [float("inf")] * 5}, "matrix or model of a camera is not valid"),
    "coefficients of null": ({"camera_distortion": None}, "matrix or model of a camera is not valid"),
}


@pytest.mark.parametrize("lie", LENSES)
def test_a_lens_that_is_none_is_refused(copied: Path, lie: str) -> None:
    change, why = LENSES[lie]
    rewritten(copied, "calibrated_sensor", lambda rows: of(rows, "CAM_FRONT").update(change))
    with pytest.raises(DamagedExportError, match=why):
        frames(copied)


def test_a_camera_of_no_size_has_no_lens(copied: Path) -> None:
    def shrink(rows: Rows) -> None:
        for row in rows:
            row.update(width=0)

    rewritten(copied, "sample_data", shrink)
    assert frames(copied)[0].data["CAM_FRONT"].sensor.intrinsics is None


def test_a_table_that_is_missing_is_named(copied: Path) -> None:
    (copied / "v1.0-trainval" / "ego_pose.json").unlink()
    with pytest.raises(DamagedExportError, match=r"'v1\.0-trainval/ego_pose\.json' cannot be read: it is missing"):
        frames(copied)
