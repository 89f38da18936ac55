"""`stone simulate` with the options of its cameras."""

import json
from io import BytesIO
from pathlib import Path

import pytest
from PIL import Image
from rosbags.highlevel import AnyReader
from typer.testing import CliRunner, Result

from simulator.pipeline import calibration_path
from stone_client.main import app
from stone_recordings.calibrations.file import read_calibration


def run(*words: str | Path) -> Result:
    return CliRunner().invoke(app, [str(word) for word in words])


def test_pictures_are_of_the_asked_size_detail_and_light_and_so_is_the_calibration(tmp_path: Path) -> None:
    bag, truth = tmp_path / "run.mcap", tmp_path / "truth"
    cameras = ("--camera-width", "96", "--camera-detail", "full", "--illumination", "night")
    made = run("simulate", bag, "--seconds", "0.3", "--channels", "4", "--columns", "24", "--truth", truth, *cameras)
    assert made.exit_code == 0, made.stderr
    options = json.loads((truth / "world.json").read_text("utf-8"))["options"]
    assert (options["camera_detail"], options["illumination"]) == ("full", "night")
    calibration, _ = read_calibration(calibration_path(bag))
    assert {mount.intrinsics.width_px for mount in calibration.mounts if mount.intrinsics} == {96}
    with AnyReader([bag]) as reader:
        links = [link for link in reader.connections if link.topic.endswith("/compressed")]
        pictures = [reader.deserialize(raw, link.msgtype).data for link, _, raw in reader.messages(links)]
    assert {Image.open(BytesIO(picture.tobytes())).size for picture in pictures} == {(96, 60)}


@pytest.mark.parametrize(("option", "word"), [("--illumination", "noon"), ("--camera-detail", "fine")])
def test_a_word_that_is_not_known_is_refused_with_those_that_are(option: str, word: str, tmp_path: Path) -> None:
    refused = run("simulate", tmp_path / "run.mcap", option, word)
    assert refused.exit_code == 1
    assert f"is '{word}'; it must be one of" in refused.stderr
    assert not list(tmp_path.iterdir())
