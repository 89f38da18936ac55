"""A ROS 1 bag goes the whole way; what comes out is what its MCAP twin makes, byte for byte.

Catches alone a bag that is read otherwise in the sandbox, from the store, or by the workers than by its tests.
"""

from pathlib import Path

import numpy as np
import pytest

from services.ingest.pipeline import SynchroniseOptions
from services.ingest.sequence import opened_sequence
from services.labeler.local_run import LabelOptions, label
from services.runtime.platform import Platform
from simulator.pipeline import calibration_path
from testing.worlds.ros1_bags import ROS1_COMPRESSIONS, Ros1Compression, as_ros1, unclosed
from testing.worlds.runs import NAME, bring, differing, files_of_label, run_all, simulated


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("field"))


@pytest.mark.parametrize("compression", ROS1_COMPRESSIONS)
def test_the_sequence_of_a_bag_is_that_of_the_mcap_file(
    drive: Path, tmp_path: Path, compression: Ros1Compression
) -> None:
    bag = unclosed(as_ros1(drive, tmp_path / "run.bag", compression), tmp_path / "run.bag.active")
    opened = [opened_sequence(one, calibration_path(drive), NAME, SynchroniseOptions()) for one in (bag, drive)]
    with opened[0] as found, opened[1] as expected:
        ours, theirs = (one.sequence.frames for one in (found, expected))
        assert ours.tokens == theirs.tokens
        assert np.array_equal(ours.map_from_ego.wxyz_xyz, theirs.map_from_ego.wxyz_xyz)
        for number in range(0, len(ours), 10):
            assert np.array_equal(found.sweeps.sweep(number).points_lidar, expected.sweeps.sweep(number).points_lidar)


@pytest.mark.whole
def test_the_platform_makes_of_an_uploaded_bag_the_labels_of_the_mcap_file(
    drive: Path, tmp_path: Path, platform: Platform
) -> None:
    """Its recorder died before it wrote the index."""
    folder = tmp_path / "labels"
    with opened_sequence(drive, calibration_path(drive), NAME, SynchroniseOptions()) as opened:
        options = LabelOptions(workers=2, late_inputs=opened.recording_inputs, late_findings=opened.late_findings)
        label(opened.sequence, opened.sweeps, folder, options)
    expected = {name: content for name, content in files_of_label(folder).items() if name.endswith("labels.npz")}
    brought = bring(platform)
    brought.calibrate(calibration_path(drive))
    brought.add(unclosed(as_ros1(drive, tmp_path / "run.bag", "lz4"), tmp_path / "run.bag.active"))
    run_all(platform)
    assert brought.recording().state == "registered"
    run_id = brought.process()
    run_all(platform)
    assert (brought.job(run_id).state, brought.job(run_id).failure) == ("succeeded", "")
    found = {name: content for name, content in brought.files().items() if name.endswith("labels.npz")}
    assert expected
    assert differing(found, expected) == []
