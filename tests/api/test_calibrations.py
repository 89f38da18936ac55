"""Calibrations: read before they are kept, true of a span of time; hostile files cost little, nothing kept changes."""

import io
import socket
import zipfile
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest

from api import sandboxed_reading
from api.views import calibration_reading
from services.runtime.platform import Platform
from services.runtime.sandbox.result_files import packed
from testing.api.serving import Person, at_once, person
from testing.worlds.made import sequence

URL = "/api/v1/calibrations"
RADAR = b"""sensors:
  RADAR_FRONT:
    kind: radar
    lidar_from_sensor: {translation_m: [1.5, 0.0, -0.9], rotation_wxyz: [1.0, 0.0, 0.0, 0.0]}
"""
EXAMPLE = (Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml").read_bytes()
PLAIN = EXAMPLE.replace(b"sensors: {}\n", RADAR)


def posted(
    api: httpx.Client, caller: Person, content: bytes = PLAIN, filename: str = "rig.yaml", **headers: str
) -> httpx.Response:
    return api.post(URL, files={"file": (filename, content)}, headers=caller.headers | headers)


def kept(api: httpx.Client, caller: Person, content: bytes = PLAIN, filename: str = "rig.yaml") -> dict[str, Any]:
    answer = posted(api, caller, content, filename)
    assert answer.status_code == 201, answer.text
    item: dict[str, Any] = answer.json()
    return item


BOMB = b"a: &a [x, x, x, x, x, x, x, x, x]\n" + b"".join(
    b"%c: &%c [*%c, *%c, *%c, *%c, *%c, *%c]\n" % ((i, i) + (i - 1,) * 6) for i in range(98, 108)
)


def test_what_is_no_calibration_is_refused_with_its_code(api: httpx.Client, curator: Person) -> None:
    for content, code in [
        (b"", "CAL-423"),
        (b"#" * 1_000_001, "CAL-420"),
        (BOMB, "CAL-421"),
        (b"stone_calibration: 1\nnmae: rig\n", "CAL-422"),
    ]:
        answer = posted(api, curator, content)
        body = answer.json()
        assert (answer.status_code, body["code"]) == (422, "calibration_refused")
        assert [error["code"] for error in body["errors"]] == [code]
        assert body["errors"][0]["detail"][:60] in body["detail"]
        assert api.get(URL, headers=curator.headers).json()["items"] == []


def test_a_name_that_nobody_can_see_is_refused(api: httpx.Client, curator: Person) -> None:
    for before, name in ((b"kitti-2011_09_26", b'"a\\u202eb"'), (b"RADAR_FRONT", b'"\\e[2J"')):
        answer = posted(api, curator, PLAIN.replace(before, name))
        assert answer.status_code == 422, answer.text
        assert [error["code"] for error in answer.json()["errors"]] == ["CAL-422"]


def test_a_hostile_file_name_becomes_a_plain_one(api: httpx.Client, curator: Person) -> None:
    for filename in ["../../etc/passwd", 'a"; x=".yaml', "a\r\nX: é", "." * 300]:
        item = kept(api, curator, PLAIN + f"# {filename!a}\n".encode(), filename)
        assert item["filename"]
        assert set(item["filename"]) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")
        answer = api.get(f"{URL}/{item['id']}/file", headers=curator.headers)
        assert answer.headers["content-disposition"].startswith(f'attachment; filename="{item["filename"]}"')
        assert answer.content.startswith(PLAIN)


def test_a_calibration_is_kept_as_it_came(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    answer = posted(api, ada)
    item = answer.json()
    assert answer.status_code == 201
    assert (item["version"], item["sha256"], item["filename"]) == (1, sha256(PLAIN).hexdigest(), "rig.yaml")
    assert answer.headers["location"] == f"{URL}/{item['id']}"
    assert item["sensors"] == [{"name": "RADAR_FRONT", "kind": "radar", "frame_id": ""}]
    assert api.get(answer.headers["location"], headers=ada.headers).json() == item
    file = api.get(f"{URL}/{item['id']}/file", headers=ada.headers)
    assert (file.content, file.headers["content-type"]) == (PLAIN, "application/yaml")
    assert file.headers["etag"] == f'"{item["sha256"]}"'
    again = api.get(f"{URL}/{item['id']}/file", headers=ada.headers | {"If-None-Match": file.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_other_bytes_of_a_name_are_its_next_version_and_the_same_bytes_none(
    api: httpx.Client, platform: Platform
) -> None:
    ada, bob = person(platform, "curator"), person(platform, "curator")
    first, second = kept(api, ada), kept(api, ada, PLAIN + b"# measured again\n")
    again = posted(api, ada, filename="other.yaml")
    assert (again.status_code, again.json()["id"]) == (200, first["id"])
    assert (second["version"], second["name"]) == (2, first["name"])
    assert kept(api, bob)["version"] == 1, "versions are an owner's own"
    named = api.get(URL, params={"name": first["name"]}, headers=ada.headers).json()["items"]
    assert [item["version"] for item in named] == [2, 1]


def test_versions_that_come_at_once_come_one_after_another(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    made = at_once(str(api_on.base_url), 4, lambda api, number: kept(api, ada, PLAIN + b"# %d\n" % number))
    assert sorted(item["version"] for item in made) == [1, 2, 3, 4]


def test_the_same_bytes_at_once_are_kept_once(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    answers = at_once(str(api_on.base_url), 4, lambda api, _: posted(api, ada))
    assert sorted(answer.status_code for answer in answers) == [200, 200, 200, 201]
    assert len({answer.json()["id"] for answer in answers}) == 1


def test_a_sequence_pins_its_calibration(api: httpx.Client, curator: Person) -> None:
    item, made = kept(api, curator), sequence(api, curator)
    path = f"/api/v1/sequences/{made['id']}/calibration"

    def pinned(**headers: str) -> Mapping[str, Any]:
        answer = api.put(path, json={"calibration_id": item["id"]}, headers=curator.headers | headers)
        assert answer.status_code == 200, answer.text
        shown: Mapping[str, Any] = answer.json()
        return shown

    first = pinned(**{"If-Match": '"1"'})
    assert (first["calibration_id"], first["revision"]) == (item["id"], 2)
    assert pinned() == first, "a second time changes nothing"
    stale = curator.headers | {"If-Match": '"1"'}
    assert api.put(path, json={"calibration_id": item["id"]}, headers=stale).status_code == 412


def test_a_file_that_takes_over_its_reader_reaches_nothing(
    api: httpx.Client, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sandboxed_reading, "read_calibration_files", lambda _: socket.create_connection(("::1", 9)))
    answer = posted(api, curator)
    assert answer.status_code == 422
    assert [error["code"] for error in answer.json()["errors"]] == ["reader_crashed"]
    assert "raised PermissionError" in answer.json()["detail"]
    monkeypatch.setattr(
        calibration_reading, "calibration_read", lambda _: packed({"calibration": {}, "findings": [], "format": ""})
    )
    assert posted(api, curator).json()["errors"][0]["code"] == "reader_crashed"


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


def posted_of(api: httpx.Client, caller: Person, content: bytes = PLAIN, **times: str) -> httpx.Response:
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


def test_a_calibration_is_true_of_the_time_it_was_given(api: httpx.Client, curator: Person) -> None:
    item = posted_of(api, curator, valid_from=MAY, valid_to=JUNE).json()
    assert (item["valid_from"], item["valid_to"]) == (MAY, "2026-06-01T00:00:00Z")
    assert api.get(f"{URL}/{item['id']}", headers=curator.headers).json() == item
    assert kept(api, curator)["valid_from"] is None


def test_the_same_bytes_for_another_time_are_another_version(api: httpx.Client, curator: Person) -> None:
    answers = [posted_of(api, curator, **times) for times in ({}, {"valid_from": MAY}, {"valid_from": MAY}, {})]
    assert [answer.status_code for answer in answers] == [201, 201, 200, 200]
    assert [answer.json()["version"] for answer in answers] == [1, 2, 2, 1]


def test_a_time_that_never_is_is_refused(api: httpx.Client, curator: Person) -> None:
    for times, code in [
        ({"valid_from": JUNE, "valid_to": MAY}, "CAL-418"),
        ({"valid_from": MAY, "valid_to": MAY}, "CAL-418"),
        ({"valid_to": "9999-12-31T00:00:00Z"}, "CAL-418"),
        ({"valid_from": "1969-12-31T00:00:00Z"}, "CAL-418"),
        ({"valid_from": "2026-05-01T00:00:00"}, "timezone_aware"),
        ({"valid_from": "tomorrow"}, "datetime_from_date_parsing"),
    ]:
        answer = posted_of(api, curator, **times)
        assert answer.status_code == 422, answer.text
        assert [error["code"] for error in answer.json()["errors"]] == [code]


def diff_of(api: httpx.Client, caller: Person, item: dict[str, Any], **query: str) -> dict[str, Any]:
    answer = api.get(f"{URL}/{item['id']}/diff", params=query, headers=caller.headers)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def test_the_diff_says_how_far_a_sensor_moved(api: httpx.Client, curator: Person) -> None:
    first = kept(api, curator)
    second = kept(api, curator, PLAIN.replace(b"[1.5, 0.0, -0.9]", b"[1.5, 0.04, -0.87]"))
    for query in ({}, {"against": first["id"]}):
        found = diff_of(api, curator, second, **query)
        assert (found["id"], found["against"], found["is_same"]) == (second["id"], first["id"], False)
        sensor = found["sensors"][0]
        assert (sensor["name"], sensor["status"]) == ("RADAR_FRONT", "changed")
        assert sensor["transform"]["translation_m"] == pytest.approx([0.0, 0.04, 0.03])
        assert sensor["transform"]["distance_m"] == pytest.approx(0.05)
        assert sensor["transform"]["rotation_deg"] == 0
    assert diff_of(api, curator, first)["is_same"], "the first version is compared with itself"
    third = kept(api, curator, PLAIN + b"\nvehicle: {max_slope_deg: 30}\n")
    found = diff_of(api, curator, third, against=first["id"])
    assert not found["is_same"], "its limits decide classes"
    assert found["robot"] == [{"key": "max_slope_deg", "before": 20.0, "after": 30.0}]


def test_what_is_somebody_elses_is_not_compared_with(api: httpx.Client, curator: Person, platform: Any) -> None:
    other = person(platform, "curator")
    mine, theirs = kept(api, curator), kept(api, other)
    answer = api.get(f"{URL}/{mine['id']}/diff", params={"against": theirs["id"]}, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")
    bad = api.get(f"{URL}/{mine['id']}/diff", params={"against": "x"}, headers=curator.headers)
    assert bad.status_code == 422
