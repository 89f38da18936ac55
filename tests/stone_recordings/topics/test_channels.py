"""A channel follows from the calibration's frames, else from the words of names, and is never guessed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.sensors import rig
from stone_recordings.topics.channels import channel_of, channel_of_words


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("/camera/front/image_raw", "CAM_FRONT"),
        ("/camera/front_left/image/compressed", "CAM_FRONT_LEFT"),
        ("/left/front_camera", "CAM_FRONT_LEFT"),
        ("/cameras/rearRight/image", "CAM_BACK_RIGHT"),
        ("/sensing/camera/camera_rear_optical", "CAM_BACK"),
        ("cam_fl", "CAM_FRONT_LEFT"),
        ("CAM_BACK_LEFT", "CAM_BACK_LEFT"),
        ("/cam/frontleft/image", "CAM_FRONT_LEFT"),
        ("/zed/left/image_rect_color", "CAM_LEFT"),
        ("/camera0/image_raw", None),
        ("/bright/backlight", None),
        ("/camera/left_to_right/image", None),
        ("", None),
    ],
)
def test_words_of_a_name_say_where_a_camera_looks(name: str, channel: str | None) -> None:
    assert channel_of_words("camera", name) == channel


def test_a_frame_that_the_calibration_knows_decides_against_the_name() -> None:
    frames = {"cam3_optical": "CAM_BACK"}
    assert channel_of("camera", "/camera/front/image", "cam3_optical", frames) == "CAM_BACK"
    assert channel_of("camera", "/camera/front/image", "/cam3_optical", frames) == "CAM_BACK"
    assert channel_of("camera", "/camera/front/image", "cam4_optical", frames) == "CAM_FRONT"


def test_a_radar_is_not_taken_for_the_camera_whose_frame_it_shares() -> None:
    assert channel_of("radar", "/radar/points", "mast", {"mast": "CAM_BACK"}) is None


def test_the_frame_speaks_where_the_topic_is_silent() -> None:
    assert channel_of("radar", "/ars548/detections", "radar_left", {}) == "RADAR_LEFT"
    assert channel_of("radar", "/radar/right", "radar_left", {}) == "RADAR_RIGHT"


def test_every_topic_of_the_simulated_rig_tells_its_channel() -> None:
    for camera in rig.cameras():
        assert channel_of("camera", camera.topic, "", {}) == camera.channel
        assert channel_of("camera", "/image", camera.frame_id, {}) == camera.channel
    for channel in rig.RADARS:
        assert channel_of("radar", rig.radar_topic(channel), "", {}) == channel


@given(st.text(max_size=60))
def test_any_text_names_a_channel_or_none(name: str) -> None:
    channel = channel_of_words("camera", name)
    assert channel is None or set(channel.split("_")) <= {"CAM", "FRONT", "BACK", "LEFT", "RIGHT"}
