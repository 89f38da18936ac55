"""Each profile's report says what the other would have said, and the other says the same of itself."""

import json

import numpy as np
import pytest

from services.labeler.local_run import LabelOptions, label
from services.labeler.parameters import LabelParameters, other_profile, parameters_for
from stone.sensors.calibration import Box
from tests.services.labeler.worlds import RayCast, World, sequence_of

# A knoll beside the track: profile `local` looks at its sides, `paper` also at how high it is.
WORLD = World(
    grade=(0.06, 0.02),
    boxes=(Box((1.5, 2.0, -0.5), (3.7, 4.2, 0.5)), Box((-3.0, -3.0, -0.5), (-2.0, -2.0, 1.4))),
    frames=8,
    reach_m=6.0,
)


@pytest.fixture(scope="module")
def reports(tmp_path_factory):
    made = {}
    for profile in ("paper", "local"):
        folder = tmp_path_factory.mktemp(profile) / "out"
        label(sequence_of(WORLD), RayCast(WORLD), folder, LabelOptions(parameters_for(profile)))
        made[profile] = json.loads((folder / "report.json").read_text())
    return made


def test_both_reports_tell_the_same_of_both_profiles(reports):
    paper, local = reports["paper"]["profiles"], reports["local"]["profiles"]
    assert paper == local
    assert set(paper["class_share"]) == {"paper", "local"}
    assert paper["voxels"] == reports["paper"]["map"]["voxels"]


def test_the_profiles_differ_here_and_their_shares_are_whole(reports):
    profiles = reports["paper"]["profiles"]
    assert 0.002 < profiles["differing_share"] < 0.9
    shares = {name: np.array(list(share.values())) for name, share in profiles["class_share"].items()}
    for share in shares.values():
        assert share.sum() == pytest.approx(1, abs=3e-6)
    assert shares["paper"][0] == shares["local"][0]  # both drove over the same ground
    assert np.abs(shares["paper"] - shares["local"]).sum() / 2 <= profiles["differing_share"] + 3e-6


def test_both_say_that_the_track_does_not_span_the_relief_and_only_paper_warns_of_it(reports):
    elevation = reports["local"]["profiles"]["elevation"]
    assert elevation["track_span_m"] == pytest.approx(0.06 * 7 * 0.4, abs=0.01)
    assert 0 < elevation["paper_band_m"] < 1
    assert elevation["is_spanned"] is False
    codes = {name: {finding["code"] for finding in report["findings"]} for name, report in reports.items()}
    assert "LAB-603" in codes["paper"]
    assert "LAB-603" not in codes["local"]


def test_the_other_of_the_other_profile_is_the_profile_itself():
    for profile in ("paper", "local"):
        assert other_profile(other_profile(parameters_for(profile))) == parameters_for(profile)
    assert other_profile(LabelParameters(footprint_band_m=0.1)).footprint_band_m == 0.1
