"""What speaks against the driven ground being one Gaussian is counted on the voxels and told in the report."""

from dataclasses import replace

import numpy as np
import pytest

from services.labeler.local_run import LabelOptions, label
from services.labeler.map.comparison import ProfileComparison
from services.labeler.map.outliers import alternative_reference, outlier_counts, outlier_findings
from services.labeler.map.surface import TileSummary
from services.labeler.parameters import parameters_for
from services.labeler.report import reference_findings
from services.labeler.results import reference_from
from services.labeler.run import Tile
from stone.labels.traversability import Reference, sums_of
from stone.sensors.calibration import Box, Footprint
from tests.services.labeler.worlds import CALIBRATION, RayCast, World, sequence_of

PAPER, LOCAL = parameters_for("paper"), parameters_for("local")


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


def tile(features):
    sums = sums_of(features, np.zeros(3))
    return TileSummary(Tile(0, 0), features, sums, sums, *[len(features)] * 5)


def ground(far=0, count=1000):
    rows = np.random.default_rng(4).normal(size=(count, 3)) * [0.01, 0.02, 1.0] + [0.0, 0.03, -11.0]
    rows[:far] = [0.0, 3.1, -11.0]
    return rows


def told(far, parameters=LOCAL, changed_ratio=0.04):
    return outlier_findings(outlier_counts([tile(ground(far))], parameters.reference), parameters, changed_ratio)


def test_a_few_voxels_that_widen_the_slope_are_counted_and_told_with_what_leaves_them_out():
    assert told(0) == []
    (finding,) = told(12)
    assert finding.code == "LAB-606"
    assert "12 in slope (up to 177.6°), whose σ is 19.2° and 1.2° without them" in finding.message
    assert "reference.outlier_ratio 0.25 leaves them out; 4.0% of the map's voxels" in finding.message
    assert "profile local with reference.outlier_ratio" in told(12, PAPER)[0].message
    left_out = replace(LOCAL, reference=replace(LOCAL.reference, outlier_ratio=0.25))
    assert told(12, left_out) == []


def test_too_few_driven_voxels_are_not_judged():
    assert outlier_counts([tile(ground(9, count=499))], PAPER.reference) is None
    assert alternative_reference([tile(ground(9, count=499))], PAPER) is None


def test_the_other_estimate_is_the_robust_one_or_the_plain_one():
    tiles, left_out = [tile(ground(12))], replace(PAPER.reference, outlier_ratio=0.25)
    robust, plain = alternative_reference(tiles, PAPER), reference_from(tiles, PAPER)
    other_robust = replace(PAPER, reference=left_out)
    assert robust is not None
    np.testing.assert_array_equal(robust.covariance, reference_from(tiles, other_robust).covariance)
    np.testing.assert_array_equal(plain.covariance, alternative_reference(tiles, other_robust).covariance)
    assert robust.covariance[1, 1] < 0.01 * plain.covariance[1, 1]


@pytest.mark.whole
def test_slivers_of_wall_in_the_track_are_left_out_where_that_is_chosen(tmp_path):
    """Catches alone that the choice reaches the labels: P shrinks to what is like the ground."""
    world = World(boxes=(Box((-1.0, 0.36, -0.2), (1.0, 0.5, 0.5)),), frames=48, reach_m=5.0)
    wide = replace(sequence_of(world), calibration=replace(CALIBRATION, footprint=Footprint(width_m=1.2)))
    robust = replace(LOCAL, reference=replace(LOCAL.reference, outlier_ratio=0.25))
    plain, left_out = (
        label(wide, RayCast(world), tmp_path / name, LabelOptions(parameters)).as_record()
        for name, parameters in (("plain", LOCAL), ("robust", robust))
    )
    outliers, others = plain["reference"]["outliers"], left_out["reference"]["outliers"]
    assert outliers == others
    assert outliers["slope"]["far"] > 0
    assert outliers["reestimated_share"] > 0
    assert left_out["reference"]["covariance"][1][1] < plain["reference"]["covariance"][1][1]
    shares = [record["class_share_of_occupied"]["potentially_traversable"] for record in (plain, left_out)]
    assert shares[1] < shares[0]
