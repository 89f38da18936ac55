"""What a report tells beside its labels: what the other profile would have said, how the surface was solved for,
what speaks against the driven ground being one Gaussian; and what may be chosen from outside."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from services.domain.sequences.label_choices import BOUNDS, PROFILES
from services.labeler.local_run import LabelOptions, label
from services.labeler.map.comparison import (
    ProfileComparison,
    alternative_reference,
    limit_findings,
    outlier_counts,
    outlier_findings,
)
from services.labeler.map.convergence import convergence_findings, convergence_of
from services.labeler.map.surface import TileSummary
from services.labeler.parameters import (
    LabelParameters,
    SurfaceParameters,
    chosen_parameters,
    other_profile,
    parameters_for,
)
from services.labeler.report import reference_findings
from services.labeler.results import reference_from
from services.labeler.run import LabelRun, Tile
from stone.labels.footprint import Passes
from stone.labels.profiles import VoxelTerrain
from stone.labels.traversability import Reference
from stone.sensors.calibration import Box, Footprint
from stone.surface.screened_poisson import MOST_ROUNDS, Descent, PoissonParameters
from testing.refusals import refused_as
from tests.services.labeler.worlds import CALIBRATION, RayCast, World, sequence_of

# A knoll beside the track: profile `local` looks at its sides, `paper` also at how high it is.
KNOLL = World(
    grade=(0.06, 0.02),
    boxes=(Box((1.5, 2.0, -0.5), (3.7, 4.2, 0.5)), Box((-3.0, -3.0, -0.5), (-2.0, -2.0, 1.4))),
    frames=8,
    reach_m=6.0,
)


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    made = {}
    for profile in ("paper", "field"):
        folder = tmp_path_factory.mktemp(profile) / "out"
        label(sequence_of(KNOLL), RayCast(KNOLL), folder, LabelOptions(parameters_for(profile)))
        made[profile] = json.loads((folder / "report.json").read_text())
    return made


def test_both_reports_tell_the_same_of_both_profiles(reports):
    paper, field = reports["paper"]["profiles"], reports["field"]["profiles"]
    assert paper == field
    assert set(paper["class_share"]) == {"paper", "field"}
    assert paper["voxels"] == reports["paper"]["map"]["voxels"]


def test_the_profiles_differ_here_and_their_shares_are_whole(reports):
    profiles = reports["paper"]["profiles"]
    assert 0.002 < profiles["differing_share"] < 0.9
    shares = {name: np.array(list(share.values())) for name, share in profiles["class_share"].items()}
    for share in shares.values():
        assert share.sum() == pytest.approx(1, abs=3e-6)
    assert shares["paper"][0] == shares["field"][0]  # both drove over the same ground
    assert np.abs(shares["paper"] - shares["field"]).sum() / 2 <= profiles["differing_share"] + 3e-6


def test_both_say_that_the_track_does_not_span_the_relief_and_only_paper_warns_of_it(reports):
    elevation = reports["field"]["profiles"]["elevation"]
    assert elevation["track_span_m"] == pytest.approx(0.06 * 7 * 0.4, abs=0.01)
    assert 0 < elevation["paper_band_m"] < 1
    assert elevation["is_spanned"] is False
    codes = {name: {finding["code"] for finding in report["findings"]} for name, report in reports.items()}
    assert "LAB-603" in codes["paper"]
    assert "LAB-603" not in codes["field"]


def test_the_other_of_the_other_profile_is_the_profile_itself():
    for profile in ("paper", "field"):
        assert other_profile(other_profile(parameters_for(profile))) == parameters_for(profile)
    assert other_profile(LabelParameters(footprint_band_m=0.1)).footprint_band_m == 0.1


BOX = World(grade=(0.04, -0.02), boxes=(Box((1.0, 1.5, 0.0), (2.0, 2.5, 0.8)),), frames=4, reach_m=4.0)
SURFACE = SurfaceParameters()


def solved_tile(rounds: int, residual_ratio: float) -> TileSummary:
    return replace(tile(np.zeros((0, 3))), descent=Descent(rounds, residual_ratio))


def test_a_surface_that_is_solved_is_told_and_nothing_found(reports):
    solver = reports["field"]["solver"]
    assert 0 < solver["most_rounds"] < 200
    assert 0 < solver["worst_residual_ratio"] <= SURFACE.poisson.tolerance_ratio
    assert solver["unconverged_tiles"] == 0
    assert "LAB-609" not in str(reports["field"]["findings"])


@pytest.mark.whole
def test_a_surface_that_cannot_be_solved_for_in_the_rounds_is_found(tmp_path: Path) -> None:
    whole = parameters_for("local")
    endless = replace(SURFACE, poisson=PoissonParameters(tolerance_ratio=1e-300))
    report = label(sequence_of(BOX), RayCast(BOX), tmp_path / "out", LabelOptions(replace(whole, surface=endless)))
    record = report.as_record()
    solver, findings = record["solver"], record["findings"]
    assert 200 < solver["most_rounds"] <= MOST_ROUNDS
    assert solver["unconverged_tiles"] == 1
    (found,) = [finding for finding in findings if finding["code"] == "LAB-609"]
    assert found["severity"] == "warning"


@pytest.mark.parametrize("residual", [np.nan, np.inf])
def test_a_residual_that_is_no_number_is_not_converged(residual: float) -> None:
    found = convergence_of([solved_tile(5, 1e-6), solved_tile(2000, residual)], SURFACE)
    assert found is not None
    assert (found.unconverged, found.tiles) == (1, 2)
    assert found.as_record() == {"most_rounds": 2000, "worst_residual_ratio": None, "unconverged_tiles": 1}
    assert [finding.code for finding in convergence_findings(found, SURFACE)] == ["LAB-609"]


def test_of_open3d_nothing_is_said() -> None:
    octree = replace(SURFACE, solver="octree")
    assert convergence_of([solved_tile(0, 0.0)], octree) is None
    assert convergence_findings(None, octree) == ()


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
    assert codes(unlike=200) == []
    assert codes(unlike=201) == ["LAB-605"]
    assert codes(driven=499, unlike=400) == []


@pytest.mark.whole
def test_a_footprint_said_to_be_wider_than_the_robot_takes_walls_for_ground_and_is_told(tmp_path):
    walls = (Box((-3.0, 0.7, -0.2), (3.0, 1.1, 0.6)), Box((-3.0, -1.1, -0.2), (3.0, -0.7, 0.6)))
    world = World(boxes=walls, frames=8, step_m=0.8)
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
    columns = np.zeros((len(features), 11))
    columns[:, :3], columns[:, 3] = features, features[:, 0]
    terrain = VoxelTerrain(np.arange(len(features)), columns)
    return TileSummary(
        Tile(0, 0), terrain, Passes(np.zeros(len(features)), np.zeros(len(features))), *[len(features)] * 5
    )


def ground(far=0, count=1000):
    rows = np.random.default_rng(4).normal(size=(count, 3)) * [0.01, 0.02, 1.0] + [0.0, 0.03, -11.0]
    rows[:far] = [0.0, 3.1, -11.0]
    return rows


def compared(steep_p, steep_p_other, steep=1000, beyond=0):
    counts = np.array([[500, 0, 0], [0, 250, 0], [0, 0, 250]])
    return ProfileComparison(counts, 1000, 50, beyond, 40, steep, steep_p, steep_p_other)


def told(far, parameters=PAPER, comparison=None):
    counts = outlier_counts([tile(ground(far))], parameters)
    return outlier_findings(counts, parameters, comparison or compared(70, 10))


def test_a_few_voxels_that_widen_the_slope_are_told_if_steep_ground_becomes_drivable_by_them():
    assert told(0) == []
    (finding,) = told(12)
    assert finding.code == "LAB-606"
    for value in ("12 ", "177.6°", "19.2°", "1.2°", "7.0%", "1.0%", "4.0%", "Profile field"):
        assert value in finding.message
    assert told(12, comparison=compared(40, 10)) == []
    assert told(12, comparison=compared(70, 60)) == []
    assert len(told(12, comparison=compared(0, 0, steep=99))) == 1
    assert told(12, LOCAL) == []


def test_driven_ground_beyond_the_vehicles_limits_is_told():
    assert limit_findings(compared(0, 0, beyond=120)) == []
    (finding,) = limit_findings(compared(0, 0, beyond=121))
    assert (finding.code, "12.1%" in finding.message) == ("LAB-615", True)


def test_too_few_driven_voxels_are_not_judged():
    assert outlier_counts([tile(ground(9, count=499))], PAPER) is None
    assert alternative_reference(run_of(PAPER), [tile(ground(9, count=499))]) is None


def run_of(parameters):
    return LabelRun(sequence_of(KNOLL), RayCast(KNOLL), parameters, Path())


def test_the_other_estimate_leaves_outliers_out_or_counts_them():
    tiles, counted = [tile(ground(12))], replace(LOCAL, reference=replace(LOCAL.reference, clean_mads=0.0))
    cleaned, plain = (reference_from(run_of(one), tiles) for one in (LOCAL, counted))
    others = [alternative_reference(run_of(one), tiles) for one in (counted, LOCAL)]
    for made, other in zip((cleaned, plain), others, strict=True):
        assert other is not None
        np.testing.assert_array_equal(made.covariance, other.covariance)
    assert cleaned.left_out >= 12
    assert cleaned.covariance[1, 1] < 0.05 * plain.covariance[1, 1]


@pytest.mark.whole
def test_slivers_of_wall_in_the_track_are_left_out_where_that_is_chosen(tmp_path):
    """Catches alone that the choice reaches the labels: P shrinks to what is like the ground."""
    world = World(boxes=(Box((-1.0, 0.36, -0.2), (1.0, 0.5, 0.5)),), frames=24, step_m=0.8, reach_m=5.0)
    wide = replace(sequence_of(world), calibration=replace(CALIBRATION, footprint=Footprint(width_m=1.2)))
    counted = replace(LOCAL, reference=replace(LOCAL.reference, clean_mads=0.0))
    plain, left_out = (
        label(wide, RayCast(world), tmp_path / name, LabelOptions(parameters)).as_record()
        for name, parameters in (("plain", counted), ("cleaned", LOCAL))
    )
    outliers, others = plain["reference"]["outliers"], left_out["reference"]["outliers"]
    assert outliers == others
    assert outliers["slope"]["far"] > 0
    assert outliers["reestimated_share"] > 0
    assert left_out["reference"]["covariance"][1][1] < plain["reference"]["covariance"][1][1]
    shares = [record["class_share_of_occupied"]["potentially_traversable"] for record in (plain, left_out)]
    assert shares[1] < shares[0]


def leaf(record: object, name: str) -> object:
    for part in name.split("."):
        record = record[part]  # type: ignore[index]
    return record


@pytest.mark.parametrize("name", BOUNDS)
@pytest.mark.parametrize("profile", PROFILES)
def test_every_choice_is_a_parameter_whose_default_lies_within_its_bounds(profile: str, name: str) -> None:
    default = leaf(asdict(parameters_for(profile)), name)  # type: ignore[arg-type]
    low, high = BOUNDS[name]
    assert type(default) is type(low) is type(high)
    assert low <= default <= high  # type: ignore[operator]


@pytest.mark.parametrize("name", BOUNDS)
def test_a_choice_changes_that_parameter_and_no_other(name: str) -> None:
    low, _ = BOUNDS[name]
    chosen, plain = asdict(chosen_parameters("local", {name: low})), asdict(parameters_for("local"))
    assert leaf(chosen, name) == low
    if "." in name:
        group, part = name.split(".")
        chosen[group][part] = plain[group][part]
    else:
        chosen[name] = plain[name]
    assert chosen == plain


def test_no_choice_is_the_profile_itself() -> None:
    assert chosen_parameters("paper", {}) == LabelParameters()
    with refused_as("bad_parameter"):
        chosen_parameters("paper", {"tiling.cube_cells": 1})


def test_the_paper_leaves_no_driven_voxel_out() -> None:
    assert chosen_parameters("paper", {"reference.outlier_ratio": 0.0}) == LabelParameters()
    for name in ("reference.outlier_ratio", "reference.clean_mads"):
        with refused_as("bad_parameter"):
            chosen_parameters("paper", {name: 0.25})
