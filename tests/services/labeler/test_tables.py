"""The frame table: a row per stamp with what each frame was made of and how good its pose is."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from services.labeler.frames import FrameVoxelCounts
from services.labeler.tables import write_frames
from stone.geometry.se3 import SE3
from stone.sensors.calibration import Calibration
from stone.sensors.pose_quality import PoseQuality, Rtk
from stone.sensors.sequence import Association, ExcludedFrame, Frames, Sequence, Slices

STAMPS_NS = np.array([10, 20, 40], np.int64)
COUNTS = FrameVoxelCounts(np.arange(12).reshape(3, 4), np.arange(6).reshape(3, 2), np.arange(3))
FRAMES = Frames(
    STAMPS_NS,
    ("a", "b", "c"),
    SE3.identity((3,)),
    {
        "CAM_FRONT": Association("/cam", np.array([4, -1, 6]), np.array([3, 0, 5]), phase_ns=4),
        "/odd/radar": Association("/odd/radar", np.array([0, 1, 2]), np.array([-1, 0, 1])),
    },
    {"IMU": Slices("/imu", np.array([2, 5, 9, 9], np.int64))},
    PoseQuality(
        np.array([0, 50, 50]),
        np.array([Rtk.FIXED, Rtk.FLOAT, Rtk.UNKNOWN], np.uint8),
        np.array([[0.01, 0.02, 0.03], [0.1, 0.2, 0.3], [np.nan] * 3]),
    ),
    Association("/points", np.array([1, 2, 4]), np.zeros(3, np.int64)),
)
SEQUENCE = Sequence(
    "run",
    FRAMES,
    (ExcludedFrame(30, "pose_jump", "the track jumps during the sweep"),),
    Calibration("rig", SE3.identity()),
    "/ins (INSPVAX)",
    (48.0, 11.0, 500.0),
    {"run.mcap": "ab"},
)


@pytest.fixture
def table(tmp_path: Path) -> Path:
    write_frames(tmp_path / "frames.parquet", SEQUENCE, COUNTS)
    return tmp_path / "frames.parquet"


def test_every_frame_names_its_messages_and_an_excluded_stamp_its_reason(table):
    rows = pq.read_table(table).to_pylist()
    assert [row["stamp_ns"] for row in rows] == [10, 20, 30, 40]
    taken = ("LIDAR_topic", "LIDAR_index", "LIDAR_dt_ns", "CAM_FRONT_topic", "CAM_FRONT_index", "CAM_FRONT_dt_ns")
    assert [tuple(row[name] for name in taken) for row in rows] == [
        ("/points", 1, 0, "/cam", 4, 3),
        ("/points", 2, 0, "/cam", -1, 0),
        (None,) * 6,
        ("/points", 4, 0, "/cam", 6, 5),
    ]
    assert [row["/odd/radar_dt_ns"] for row in rows] == [-1, 0, None, 1]
    assert [(row["IMU_start"], row["IMU_stop"]) for row in rows] == [(2, 5), (5, 9), (None, None), (9, 9)]
    assert [row["exclusion_code"] for row in rows] == [None, None, "pose_jump", None]


def test_every_frame_says_how_good_its_pose_is_and_null_is_unknown(table):
    rows = pq.read_table(table).to_pylist()
    assert [row["rtk_status"] for row in rows] == ["fixed", "float", None, "unknown"]
    assert [row["pose_gap_ns"] for row in rows] == [0, 50, None, 50]
    stdev = [tuple(row[f"{axis}_stdev_m"] for axis in ("east", "north", "up")) for row in rows]
    assert stdev == [(0.01, 0.02, 0.03), (0.1, 0.2, 0.3), (None,) * 3, (None,) * 3]


def test_the_table_says_what_it_was_made_of(table):
    about = json.loads(pq.read_schema(table).metadata[b"stone"])
    assert about == {
        "sequence": "run",
        "vehicle": SEQUENCE.calibration.name,
        "inputs": {"run.mcap": "ab"},
        "pose_source": "/ins (INSPVAX)",
        "map_origin_deg_m": [48.0, 11.0, 500.0],
        "phase_ns": {"CAM_FRONT": 4},
    }


def test_equal_sequences_give_equal_bytes(table, tmp_path):
    write_frames(tmp_path / "again.parquet", SEQUENCE, COUNTS)
    assert (tmp_path / "again.parquet").read_bytes() == table.read_bytes()


def test_frames_that_no_recording_gave_have_neither_quality_nor_messages(tmp_path):
    frames = replace(FRAMES, associations={}, slices={}, quality=None, sweeps=None)
    write_frames(tmp_path / "a.parquet", replace(SEQUENCE, frames=frames, excluded=()), COUNTS)
    names = pq.read_schema(tmp_path / "a.parquet").names
    assert not [name for name in names if name.endswith(("_index", "_dt_ns", "_topic", "_stdev_m", "rtk_status"))]
