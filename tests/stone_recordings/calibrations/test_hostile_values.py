"""Any value anywhere in any format may be anything: the answer is a calibration of finite numbers, or a refusal."""

import copy
import json
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stone.errors import StoneError
from stone_files.calibration_bundle import Bundle
from stone_recordings.calibrations.file import read_files
from tests.stone_recordings.calibrations import robots

WRITERS = [robots.ros_matrices, robots.kalibr, robots.opencalib, robots.nuscenes, robots.autoware]
WRITERS += [robots.rellis, robots.kitti, robots.stereo]
HOSTILE = [
    None, True, 0, -1, 1, 0.5, 10**400, 1e308, -1e308, 5e-324, float("nan"), float("inf"), "", "nan", "-inf", "1e999",
    "base_link", "hesai_lidar", "\x00", "\u202e", "x" * 200, [], {}, [[]], [[], []], [1], [[1]], ["a"] * 16,
    {"data": []}, {"data": 1}, [None] * 16, [[0] * 4] * 4, [[1e200] * 4] * 4, [[float("nan")] * 4] * 4, [0] * 16, [{}],
]  # fmt: skip


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every value in nested lists and dicts."""
    keys = value if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield (*path, key)
        yield from places(value[key], (*path, key))


def damage(files: Any, path: tuple[Any, ...], data: st.DataObject) -> None:
    """Put something else there, take it away, or call it something else."""
    for key in path[:-1]:
        files = files[key]
    how = data.draw(st.sampled_from(["replaced", "removed", "renamed", "repeated"]))
    if how == "removed":
        del files[path[-1]]
    elif how == "renamed" and isinstance(files, dict):
        files[data.draw(st.sampled_from(["", "a", "T_a__b", "cam0", "stone_rig", "sensor_kit_x"]))] = files.pop(
            path[-1]
        )
    elif how == "repeated" and isinstance(files, list):
        files.append(copy.deepcopy(files[path[-1]]))
    else:
        files[path[-1]] = copy.deepcopy(data.draw(st.sampled_from(HOSTILE)))


def check_sentence(refused: StoneError) -> None:
    assert "\n" not in str(refused)
    assert len(str(refused)) < 900
    assert refused.code.startswith("CAL-") or refused.code == "bad_shape"


@pytest.mark.parametrize("writer", WRITERS)
@settings(max_examples=120, deadline=None)
@given(data=st.data())
def test_no_value_is_more_than_a_refusal(writer: Callable[[], dict[str, object]], data: st.DataObject) -> None:
    files = {name: content for name, content in copy.deepcopy(writer()).items() if not isinstance(content, str)}
    for _ in range(data.draw(st.integers(1, 3))):
        ways = list(places(files))
        if ways:
            damage(files, data.draw(st.sampled_from(ways)), data)
    documents = tuple((str(name) or "x", json.dumps(content).encode()) for name, content in sorted(files.items()))
    try:
        found = read_files(Bundle(documents), "rig.zip").calibration
    except StoneError as refused:
        check_sentence(refused)
        return
    for pose in (found.ego_from_lidar, *(mount.lidar_from_sensor for mount in found.mounts)):
        assert np.isfinite(pose.wxyz_xyz).all()
        assert np.linalg.norm(pose.wxyz) == pytest.approx(1, abs=1e-6)
