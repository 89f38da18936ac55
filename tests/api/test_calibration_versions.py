"""Calibrations over time: each is true of a span of time, no version ever changes, and what changed can be asked."""

import io
import zipfile
from typing import Any

import httpx
import pytest

from testing.api.serving import Person, person
from tests.api.test_calibrations import PLAIN, URL, kept

MAY, JUNE = "2026-05-01T00:00:00Z", "2026-06-01T02:00:00+02:00"
CAMERA = b"""image_width: 640
image_height: 480
camera_name: camera_front
camera_matrix: {data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}
distortion_coefficients: {data: [0, 0, 0, 0, 0]}
"""
FRAMES = (
    b"T_base_link__hesai_lidar: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0.9, 0, 0, 0, 1]\n"
    b"T_base_link__camera_front: [0, 0, 1, 0.2, -1, 0, 0, 0, 0, -1, 0, 0.8, 0, 0, 0, 1]\n"
)


def posted(api: httpx.Client, caller: Person, content: bytes = PLAIN, **times: str) -> httpx.Response:
    return api.post(URL, files={"file": ("rig.yaml", content)}, data=times, headers=caller.headers)


def bundle(**files: bytes) -> bytes:
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, content in files.items():
            archive.writestr(f"{name}.yaml", content)
    return packed.getvalue()


def test_a_zip_of_files_that_complete_each_other_is_one_calibration(api: httpx.Client, curator: Person) -> None:
    content = bundle(front=CAMERA, frames=FRAMES)
    item = kept(api, curator, content, "mule.zip")
    assert (item["format"], item["name"]) == ("ros_camera_info", "mule")
    assert [finding["code"] for finding in item["findings"]] == ["CAL-436"]  # no footprint in it
    assert item["sensors"] == [{"name": "CAM_FRONT", "kind": "camera", "frame_id": "camera_front"}]
    file = api.get(f"{URL}/{item['id']}/file", headers=curator.headers)
    assert (file.content, file.headers["content-type"]) == (content, "application/zip")


def test_half_a_rig_is_refused_and_says_what_to_add(api: httpx.Client, curator: Person) -> None:
    answer = posted(api, curator, CAMERA)
    assert (answer.status_code, answer.json()["errors"][0]["code"]) == (422, "CAL-424")
    assert "stone_rig: 1" in answer.json()["detail"]


def test_a_calibration_is_true_of_the_time_it_was_given(api: httpx.Client, curator: Person) -> None:
    item = posted(api, curator, valid_from=MAY, valid_to=JUNE).json()
    assert (item["valid_from"], item["valid_to"]) == (MAY, "2026-06-01T00:00:00Z")
    assert api.get(f"{URL}/{item['id']}", headers=curator.headers).json() == item
    assert kept(api, curator)["valid_from"] is None


def test_the_same_bytes_for_another_time_are_another_version(api: httpx.Client, curator: Person) -> None:
    answers = [posted(api, curator, **times) for times in ({}, {"valid_from": MAY}, {"valid_from": MAY}, {})]
    assert [answer.status_code for answer in answers] == [201, 201, 200, 200]
    assert [answer.json()["version"] for answer in answers] == [1, 2, 2, 1]


@pytest.mark.parametrize(
    ("times", "code"),
    [
        ({"valid_from": JUNE, "valid_to": MAY}, "CAL-418"),
        ({"valid_from": MAY, "valid_to": MAY}, "CAL-418"),
        ({"valid_to": "9999-12-31T00:00:00Z"}, "CAL-418"),
        ({"valid_from": "1969-12-31T00:00:00Z"}, "CAL-418"),
        ({"valid_from": "2026-05-01T00:00:00"}, "timezone_aware"),
        ({"valid_from": "tomorrow"}, "datetime_from_date_parsing"),
    ],
)
def test_a_time_that_never_is_is_refused(api: httpx.Client, curator: Person, times: dict[str, str], code: str) -> None:
    answer = posted(api, curator, **times)
    assert answer.status_code == 422, answer.text
    assert [error["code"] for error in answer.json()["errors"]] == [code]


def changed(api: httpx.Client, caller: Person, item: dict[str, Any], **query: str) -> dict[str, Any]:
    answer = api.get(f"{URL}/{item['id']}/diff", params=query, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_the_diff_says_how_far_a_sensor_moved(api: httpx.Client, curator: Person) -> None:
    first = kept(api, curator)
    second = kept(api, curator, PLAIN.replace(b"[1.5, 0.0, -0.9]", b"[1.5, 0.04, -0.87]"))
    for query in ({}, {"against": first["id"]}):
        found = changed(api, curator, second, **query)
        assert (found["id"], found["against"], found["is_same"]) == (second["id"], first["id"], False)
        sensor = found["sensors"][0]
        assert (sensor["name"], sensor["status"]) == ("RADAR_FRONT", "changed")
        assert sensor["transform"]["translation_m"] == pytest.approx([0.0, 0.04, 0.03])
        assert sensor["transform"]["distance_m"] == pytest.approx(0.05)
        assert sensor["transform"]["rotation_deg"] == 0
    assert changed(api, curator, first)["is_same"], "the first version is compared with itself"


def test_what_is_somebody_elses_is_not_compared_with(api: httpx.Client, curator: Person, platform: Any) -> None:
    other = person(platform, "curator")
    mine, theirs = kept(api, curator), kept(api, other)
    answer = api.get(f"{URL}/{mine['id']}/diff", params={"against": theirs["id"]}, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    bad = api.get(f"{URL}/{mine['id']}/diff", params={"against": "x"}, headers=curator.headers)
    assert bad.status_code == 422
