"""Calibrations: what comes in is read before it is kept, hostile files cost little, what is kept never changes."""

import socket
import threading
from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest

from api.views import calibration_reading
from services.runtime.platform import Platform
from services.runtime.sandbox.result_files import packed
from testing.api.serving import Person, client_of, person
from testing.worlds.made import NOBODY, sequence

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


def test_nobody_without_a_token_adds_or_sees_one(api: httpx.Client) -> None:
    assert api.post(URL, files={"file": ("rig.yaml", PLAIN)}).status_code == 401
    for path in ("", f"/{NOBODY}", f"/{NOBODY}/file"):
        assert api.get(URL + path).status_code == 401


def test_a_participant_adds_none(api: httpx.Client, participant: Person) -> None:
    assert posted(api, participant).status_code == 403


def test_a_calibration_of_somebody_else_does_not_exist(
    api: httpx.Client, platform: Platform, curator: Person, administrator: Person
) -> None:
    item, other = kept(api, curator), person(platform, "curator")
    for path in (f"/{item['id']}", f"/{item['id']}/file"):
        assert api.get(URL + path, headers=other.headers).status_code == 404
        assert api.get(URL + path, headers=administrator.headers).status_code == 200
    assert api.get(URL, headers=other.headers).json()["items"] == []
    own = sequence(api, other)
    pin = api.put(
        f"/api/v1/sequences/{own['id']}/calibration", json={"calibration_id": item["id"]}, headers=other.headers
    )
    assert pin.status_code == 404


def test_a_file_beyond_a_mebibyte_is_not_read(api: httpx.Client, curator: Person) -> None:
    answer = posted(api, curator, b"#" * (2**20 + 1))
    assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")


def test_what_is_no_form_is_not_understood(api: httpx.Client, curator: Person) -> None:
    plain = api.post(URL, content=PLAIN, headers=curator.headers | {"Content-Type": "application/yaml"})
    assert plain.status_code == 415, plain.text
    empty = api.post(URL, files={"other": ("rig.yaml", PLAIN)}, headers=curator.headers)
    assert empty.status_code == 422


BOMB = b"a: &a [x, x, x, x, x, x, x, x, x]\n" + b"".join(
    b"%c: &%c [*%c, *%c, *%c, *%c, *%c, *%c]\n" % ((i, i) + (i - 1,) * 6) for i in range(98, 108)
)


@pytest.mark.parametrize(
    ("content", "code"),
    [
        (b"", "CAL-423"),
        (b"\x93NUMPY\xff", "CAL-421"),
        (b"#" * 1_000_001, "CAL-420"),
        (BOMB, "CAL-421"),
        (b"a:\n" + b"".join(b" " * i + b"a:\n" for i in range(1, 40)), "CAL-421"),
        (b"[" * 100_000, "CAL-421"),
        (b"- a\n" * 100_000, "CAL-421"),
        (b"!!python/object/apply:os.system ['true']", "CAL-421"),
        (b"stone_calibration: 1\nnmae: rig\n", "CAL-422"),
        (PLAIN.replace(b"ego_from_lidar", b"lidar_from_ego"), "CAL-422"),
        (b"stone_calibration: 1\nname: " + b"9" * 900_000, "CAL-421"),
        (b"cam0: {}\n", "CAL-422"),
        (b"colour: red\n", "CAL-423"),
    ],
)
def test_what_is_no_calibration_is_refused_with_its_code(
    api: httpx.Client, curator: Person, content: bytes, code: str
) -> None:
    answer = posted(api, curator, content)
    body = answer.json()
    assert (answer.status_code, body["code"]) == (422, "calibration_refused")
    assert [error["code"] for error in body["errors"]] == [code]
    assert body["errors"][0]["expected"][:60] in body["detail"]
    assert api.get(URL, headers=curator.headers).json()["items"] == []


@pytest.mark.parametrize("name", [b'"a\\0b"', b'"\\e[2J"', b'"a\\u202eb"'])
@pytest.mark.parametrize("before", [b"kitti-2011_09_26", b"RADAR_FRONT"])
def test_a_name_that_nobody_can_see_is_refused(api: httpx.Client, curator: Person, before: bytes, name: bytes) -> None:
    answer = posted(api, curator, PLAIN.replace(before, name))
    assert answer.status_code == 422, answer.text
    assert [error["code"] for error in answer.json()["errors"]] == ["CAL-422"]


@pytest.mark.parametrize("filename", ["../../etc/passwd", 'a"; x=".yaml', "a\r\nX: y", "é.yaml", "." * 300, "\\\\"])
def test_a_hostile_file_name_becomes_a_plain_one(api: httpx.Client, curator: Person, filename: str) -> None:
    item = kept(api, curator, filename=filename)
    assert item["filename"]
    assert set(item["filename"]) <= set("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")
    answer = api.get(f"{URL}/{item['id']}/file", headers=curator.headers)
    assert answer.headers["content-disposition"].startswith(f'attachment; filename="{item["filename"]}"')
    assert answer.content == PLAIN


def test_a_calibration_is_kept_as_it_came(api_on: httpx.Client, platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    answer = posted(api_on, ada)
    item = answer.json()
    assert answer.status_code == 201
    assert (item["version"], item["sha256"], item["filename"]) == (1, sha256(PLAIN).hexdigest(), "rig.yaml")
    assert answer.headers["location"] == f"{URL}/{item['id']}"
    assert item["sensors"] == [{"name": "RADAR_FRONT", "kind": "radar", "frame_id": ""}]
    assert api_on.get(answer.headers["location"], headers=ada.headers).json() == item
    file = api_on.get(f"{URL}/{item['id']}/file", headers=ada.headers)
    assert (file.content, file.headers["content-type"]) == (PLAIN, "application/yaml")
    assert file.headers["etag"] == f'"{item["sha256"]}"'
    again = api_on.get(f"{URL}/{item['id']}/file", headers=ada.headers | {"If-None-Match": file.headers["etag"]})
    assert (again.status_code, again.content) == (304, b"")


def test_other_bytes_of_a_name_are_its_next_version_and_the_same_bytes_none(
    api_on: httpx.Client, platform_on: Platform
) -> None:
    ada, bob = person(platform_on, "curator"), person(platform_on, "curator")
    first, second = kept(api_on, ada), kept(api_on, ada, PLAIN + b"# measured again\n")
    again = posted(api_on, ada, filename="other.yaml")
    assert (again.status_code, again.json()["id"]) == (200, first["id"])
    assert (second["version"], second["name"]) == (2, first["name"])
    assert kept(api_on, bob)["version"] == 1, "versions are an owner's own"
    named = api_on.get(URL, params={"name": first["name"]}, headers=ada.headers).json()["items"]
    assert [item["version"] for item in named] == [2, 1]


def test_versions_that_come_at_once_come_one_after_another(platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    with client_of(platform_on) as api:
        versions: list[int] = []

        def add(number: int) -> None:
            with httpx.Client(base_url=api.base_url, timeout=300) as own:
                versions.append(kept(own, ada, PLAIN + b"# %d\n" % number)["version"])

        threads = [threading.Thread(target=add, args=(number,)) for number in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(versions) == [1, 2, 3, 4]


def test_the_same_bytes_at_once_are_kept_once(platform_on: Platform) -> None:
    ada = person(platform_on, "curator")
    with client_of(platform_on) as api:
        answers: list[tuple[int, str]] = []

        def add() -> None:
            with httpx.Client(base_url=api.base_url, timeout=300) as own:
                answer = posted(own, ada)
                answers.append((answer.status_code, answer.json()["id"]))

        threads = [threading.Thread(target=add) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert sorted(status for status, _ in answers) == [200, 200, 200, 201]
    assert len({made for _, made in answers}) == 1


def test_what_was_mended_is_said(api: httpx.Client, curator: Person) -> None:
    item = kept(api, curator, slightly_off(PLAIN))
    assert item["findings"]
    assert all(finding["severity"] == "warning" for finding in item["findings"])
    assert api.get(f"{URL}/{item['id']}", headers=curator.headers).json()["findings"] == item["findings"]


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


def slightly_off(content: bytes) -> bytes:
    """The first translation moved so far that it is doubted: 20 m."""
    head, key, rest = content.partition(b"translation_m: [")
    _, comma, tail = rest.partition(b",")
    return head + key + b"20.0" + comma + tail


def test_a_file_that_takes_over_its_reader_reaches_nothing(
    api: httpx.Client, curator: Person, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration_reading, "read_calibration_files", lambda _: socket.create_connection(("::1", 9)))
    answer = posted(api, curator)
    assert answer.status_code == 422
    assert [error["code"] for error in answer.json()["errors"]] == ["reader_crashed"]
    assert "raised PermissionError" in answer.json()["detail"]
    monkeypatch.setattr(
        calibration_reading, "_read", lambda _: packed({"calibration": {}, "findings": [], "format": ""})
    )
    assert posted(api, curator).json()["errors"][0]["code"] == "reader_crashed"
