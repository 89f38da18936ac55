"""Profiles are their owner's, changed by If-Match; the dry run says what they resolve to, and saves nothing."""

from collections.abc import Mapping
from typing import Any

import httpx
import pytest

from services.runtime.orm import CalibrationRow, Recording, SequenceRow
from services.runtime.platform import Platform
from services.runtime.store import blobs
from testing.api.serving import Person, person
from testing.worlds.made import NOBODY, sequence, upload
from tests.api.test_recordings import added

PROFILES = "/api/v1/profiles"
CLOUD, IMAGE = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image"
TOPICS = [
    {"name": "/front/points", "type": CLOUD, "role": "lidar", "count": 10, "rate_hz": 10.0, "point_count": 9000},
    {"name": "/rear/points", "type": CLOUD, "role": "lidar", "count": 10, "rate_hz": 10.0, "point_count": 9000},
    {"name": "/obstacles", "type": CLOUD, "role": "lidar", "count": 10, "rate_hz": 10.0, "point_count": 12},
    {"name": "/odom", "type": "nav_msgs/msg/Odometry", "role": "odometry", "count": 50, "rate_hz": 50.0},
    {"name": "/image", "type": IMAGE, "role": "camera", "count": 9, "rate_hz": None, "frame_id": "cam7"},
]


@pytest.fixture
def roles(api: httpx.Client, platform: Platform, curator: Person) -> str:
    """The path of the dry run of a recording that was read, on the platform `rover`."""
    forest = sequence(api, curator)
    recording_id = added(api, curator, forest["id"], upload(platform, curator)).json()["recording"]["id"]
    with platform.database.transaction() as session:
        session.get_one(Recording, recording_id).inspection = {"topics": TOPICS}
        session.get_one(SequenceRow, forest["id"]).platform = "rover"
    return f"/api/v1/sequences/{forest['id']}/recordings/{recording_id}/roles"


def saved(api: httpx.Client, owner: Person, topics: Mapping[str, Any], **headers: str) -> httpx.Response:
    return api.put(f"{PROFILES}/rover", json={"topics": topics}, headers={**owner.headers, **headers})


@pytest.mark.parametrize(
    "topics",
    [
        {"lidarr": "/points"},
        {"cam_front": "/image"},
        {"lidar": ""},
        {"lidar": " /points"},
        {"lidar": "/po\u0000ints"},
        {"lidar": "x" * 257},
        {"lidar": 3},
        {"lidar": "/a", "CAM_FRONT": "/a"},
        {f"CAM_{number}": f"/{number}" for number in range(65)},
    ],
)
def test_a_profile_that_cannot_be_is_422(api: httpx.Client, curator: Person, topics: Mapping[str, Any]) -> None:
    assert saved(api, curator, topics).status_code == 422
    assert api.get(f"{PROFILES}/rover", headers=curator.headers).status_code == 404


def test_a_profile_is_made_once_and_then_changed_by_if_match(api: httpx.Client, curator: Person) -> None:
    made = saved(api, curator, {"lidar": "/a"})
    assert (made.status_code, made.headers["ETag"]) == (201, '"1"')
    assert saved(api, curator, {"lidar": "/b"}).status_code == 428
    assert saved(api, curator, {"lidar": "/b"}, **{"If-Match": '"7"'}).status_code == 412
    changed = saved(api, curator, {"lidar": "/b"}, **{"If-Match": '"1"'})
    assert (changed.status_code, changed.json()["revision"]) == (200, 2)
    same = saved(api, curator, {"lidar": "/b"}, **{"If-Match": '"2"'})
    assert same.json() == changed.json() == api.get(f"{PROFILES}/rover", headers=curator.headers).json()
    assert api.get(PROFILES, headers=curator.headers).json() == {"items": [same.json()], "next": None}


def test_a_platform_of_somebody_else_is_another_one(api: httpx.Client, platform: Platform, curator: Person) -> None:
    saved(api, curator, {"lidar": "/a"})
    other = person(platform, "curator")
    assert api.get(f"{PROFILES}/rover", headers=other.headers).status_code == 404
    assert saved(api, other, {"lidar": "/other"}).status_code == 201
    assert api.get(f"{PROFILES}/rover", headers=curator.headers).json()["topics"] == {"lidar": "/a"}


def test_the_dry_run_names_what_is_ambiguous_and_the_choice_that_ends_it(
    api: httpx.Client, curator: Person, roles: str
) -> None:
    plain = api.get(roles, headers=curator.headers).json()
    assert plain["channels"] == {"pose": "/odom"}
    assert [(found["code"], found["topic"]) for found in plain["findings"]] == [
        ("TOP-110", "/front/points"),
        ("TOP-112", "/image"),
    ]
    choices = {"topic": ["lidar=/rear/points", "CAM_FRONT=/image"]}
    tried = api.get(roles, params=choices, headers=curator.headers).json()
    assert tried["findings"] == []
    assert tried["channels"] == {"lidar": "/rear/points", "CAM_FRONT": "/image", "pose": "/odom"}
    assert api.get(roles, headers=curator.headers).json() == plain


def test_the_saved_profile_and_the_calibration_are_asked(
    api: httpx.Client, platform: Platform, curator: Person, roles: str
) -> None:
    saved(api, curator, {"lidar": "/front/points"})
    with platform.database.transaction() as session:
        mount = {"name": "CAM_BACK", "kind": "camera", "frame_id": "cam7"}
        (platform.settings.root / "rig.yaml").write_bytes(b"rig")
        blob = blobs.keep(session, platform.store, platform.settings.root / "rig.yaml")
        rig = CalibrationRow(owner_id=curator.user_id, name="rig", version=1, filename="rig.yaml", sha256=blob.sha256)
        rig.blob_sha256, rig.sensors, rig.findings = blob.sha256, [mount], []
        session.add(rig)
        session.flush()
        session.get_one(SequenceRow, roles.split("/")[4]).calibration_id = rig.id
    resolved = api.get(roles, headers=curator.headers).json()
    assert resolved["chosen"] == {"lidar": "/front/points"}
    assert resolved["channels"] == {"lidar": "/front/points", "pose": "/odom", "CAM_BACK": "/image"}
    assert resolved["findings"] == []


@pytest.mark.parametrize("choice", ["lidar", "=/a", "sonar=/a", "lidar=", "lidar=a\n"])
def test_a_choice_that_is_none_is_422(api: httpx.Client, curator: Person, roles: str, choice: str) -> None:
    assert api.get(roles, params={"topic": choice}, headers=curator.headers).status_code == 422


def test_a_recording_that_was_not_read_has_no_roles_yet(
    api: httpx.Client, platform: Platform, curator: Person, roles: str
) -> None:
    sequence_id = roles.split("/")[4]
    pending = added(api, curator, sequence_id, upload(platform, curator)).json()["recording"]["id"]
    for recording_id, status in ((pending, 409), (NOBODY, 404)):
        path = f"/api/v1/sequences/{sequence_id}/recordings/{recording_id}/roles"
        assert api.get(path, headers=curator.headers).status_code == status
