"""What speaks against the driven ground being one Gaussian is counted on the voxels and told in the report."""

from dataclasses import replace

import numpy as np

from services.labeler.local_run import LabelOptions, label
from services.labeler.map.comparison import ProfileComparison
from services.labeler.parameters import parameters_for
from services.labeler.report import reference_findings
from stone.labels.traversability import Reference
from stone.sensors.calibration import Box, Footprint
from tests.services.labeler.worlds import CALIBRATION, RayCast, World, sequence_of

PAPER = parameters_for("paper")


def reference(slope_sigma_deg):
    return Reference(np.zeros(3), np.diag([0.1, np.deg2rad(slope_sigma_deg), 1.0]) ** 2, 1000, is_floored=False)


def codes(slope_sigma_deg=7.0, driven=1000, unlike=50):
    found = reference_findings(
        PAPER, reference(slope_sigma_deg), ProfileComparison(np.zeros((3, 3), np.int64), driven, unlike)
    )
    return [finding.code for finding in found]


def test_ground_as_it_should_be_is_not_spoken_of():
    assert codes() == []
    assert codes(slope_sigma_deg=14.9, unlike=150) == []


def test_a_slope_that_no_robot_drives_is_told():
    assert codes(slope_sigma_deg=43.0) == ["LAB-604"]


def test_driven_ground_that_is_mostly_unlike_itself_is_told_where_there_is_enough_of_it():
    assert codes(unlike=151) == ["LAB-605"]
    assert codes(driven=499, unlike=400) == []


def test_a_footprint_said_to_be_wider_than_the_robot_takes_walls_for_ground_and_is_told(tmp_path):
    walls = (Box((-3.0, 0.7, -0.2), (3.0, 1.1, 0.6)), Box((-3.0, -1.1, -0.2), (3.0, -0.7, 0.6)))
    world = World(boxes=walls, frames=16)
    wide = replace(CALIBRATION, footprint=Footprint(width_m=2.0))
    options = LabelOptions(replace(PAPER, footprint_band_m=0.6))
    reports = {
        name: label(replace(sequence_of(world), calibration=rig), RayCast(world), tmp_path / name, options)
        for name, rig in (("narrow", CALIBRATION), ("wide", wide))
    }
    told = {name: {finding.code for finding in report.findings} for name, report in reports.items()}
    assert "LAB-604" not in told["narrow"]
    assert "LAB-604" in told["wide"]
    sigma = np.rad2deg(np.sqrt(reports["wide"].reference.covariance[1, 1]))
    assert f"{sigma:.0f}°" in next(one.message for one in reports["wide"].findings if one.code == "LAB-604")
