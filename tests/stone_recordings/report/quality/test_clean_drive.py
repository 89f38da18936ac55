"""A clean drive of the whole simulated rig: everything is measured, almost nothing is deducted."""

import pytest

from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from stone_recordings.report.inspection import Inspection
from stone_recordings.report.quality.report import Quality
from tests.stone_recordings.report.quality.recordings import measured


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> tuple[Inspection, Quality]:
    path = tmp_path_factory.mktemp("clean") / "run.mcap"
    simulate(path, SimulateOptions(seconds=1.5, channels=16, columns=180, camera_width_px=64, world_width_m=40.0))
    return measured(path)


def test_the_score_is_nearly_full_and_nothing_is_left_out(clean: tuple[Inspection, Quality]) -> None:
    _, quality = clean
    assert quality.score >= 95, quality.deductions
    assert quality.left_out == ()


def test_every_sensor_of_the_rig_is_measured(clean: tuple[Inspection, Quality]) -> None:
    inspection, quality = clean
    facts = quality.facts
    assert {topic.topic for topic in facts.coverage} == {topic.topic.name for topic in inspection.topics}
    assert [camera.channel for camera in facts.cameras] == [
        "CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT",
    ]  # fmt: skip
    assert len(facts.lidars) == 1
    assert [min(radar.detections) > 0 for radar in facts.radars] == [True] * 3
    assert facts.rtk is not None
    assert facts.rtk.share("fixed") == 1.0
    for topic in facts.coverage:
        assert topic.role == "tf_static" or topic.covered_ratio == pytest.approx(1.0), topic
