"""Recordings: an upload, or several of one bag, becomes one, once, of its owner; several of a run; roles of topics."""

from collections.abc import Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import pytest

from services.domain.sequences.later_recordings import follow_recordings
from services.domain.sequences.processing import PROCESS
from services.runtime.access import storage_quota
from services.runtime.jobs.control import cancel
from services.runtime.orm import CalibrationRow, Job, LabelSet, Queue, Recording, SequenceRow, Upload
from services.runtime.platform import Platform
from services.runtime.store import blobs
from services.runtime.store.blobs import keep
from stone_files.bag_fingerprint import MOST_FILES
from testing.api.serving import Person, at_once, client_of, person
from testing.servers.fixtures import having
from testing.worlds.made import NOBODY, row_of, sequence, upload
from testing.worlds.rows import recording_of

URL = "/api/v1/sequences"


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator)


def added(api: httpx.Client, owner: Person, sequence_id: str, upload_id: str) -> httpx.Response:
    return api.post(f"{URL}/{sequence_id}/recordings", json={"upload_id": upload_id}, headers=owner.headers)


def test_an_upload_that_cannot_serve_is_refused_and_kept(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    for columns, status, code in [
        ({"state": "open"}, 409, "wrong_upload_state"),
        ({"state": "expired"}, 409, "wrong_upload_state"),
        ({"purpose": "submission"}, 409, "wrong_upload_purpose"),
        ({"target_id": NOBODY}, 409, "wrong_upload_target"),
    ]:
        upload_id = upload(platform, curator, **columns)
        answer = added(api, curator, forest["id"], upload_id)
        assert (answer.status_code, answer.json()["code"]) == (status, code)
        with platform.database.reading() as session:
            assert session.get_one(Upload, upload_id).state == columns.get("state", "complete")
            assert session.query(Recording).count() == session.query(Job).count() == 0


def test_a_draining_queue_takes_neither_the_upload_nor_the_job(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    made, upload_id = sequence(api, ada), upload(platform, ada)
    with platform.database.transaction() as session:
        session.add(Queue(name="ingest", mode="draining"))
    answer = added(api, ada, made["id"], upload_id)
    assert (answer.status_code, answer.json()["code"]) == (409, "queue_draining")
    with platform.database.transaction() as session:
        assert session.get_one(Upload, upload_id).state == "complete"
        assert session.query(Recording).count() == session.query(Job).count() == 0
        session.get_one(Queue, "ingest").mode = "open"
    assert added(api, ada, made["id"], upload_id).status_code == 202


@pytest.mark.parametrize("is_group", [False, True])
def test_of_requests_that_use_an_upload_at_once_one_does(
    api_on: httpx.Client, platform_on: Platform, is_group: bool
) -> None:
    ada = person(platform_on, "curator")
    made, upload_ids = sequence(api_on, ada), uploads(platform_on, ada)

    def use(api: httpx.Client, number: int) -> int:
        ordered = upload_ids if number % 2 else upload_ids[::-1]
        body = {"upload_ids": ordered, "name": f"run-{number}"} if is_group else {"upload_id": upload_ids[0]}
        return sealed(api, ada, made["id"], body).status_code

    assert sorted(at_once(str(api_on.base_url), 4, use)) == [202, 409, 409, 409]
    with platform_on.database.reading() as session:
        assert session.query(Recording).count() == session.query(Job).count() == 1


def test_a_recording_comes_with_the_job_that_reads_it(
    api: httpx.Client, platform: Platform, bells: list[tuple[str, int]]
) -> None:
    ada = person(platform, "curator")
    made = sequence(api, ada)
    upload_id = upload(platform, ada, b"bytes", filename="läuft.mcap", target_id=made["id"])
    answer = added(api, ada, made["id"], upload_id)
    body = answer.json()
    recording, job = body["recording"], body["job"]
    assert answer.status_code == 202
    assert answer.headers["location"] == f"{URL}/{made['id']}/recordings/{recording['id']}"
    assert (recording["state"], recording["filename"], recording["size_bytes"]) == ("received", "läuft.mcap", 5)
    assert (job["kind"], job["state"], job["sequence_id"]) == ("ingest.register", "queued", made["id"])
    assert row_of(platform, job["id"]).arguments == {"recording_id": recording["id"]}
    assert bells == [("ingest", 1)]
    shown = api.get(answer.headers["location"], headers=ada.headers).json()
    assert shown == {**recording, "inspection": None, "quality": None, "previews": []}
    listed = api.get(f"{URL}/{made['id']}/recordings", headers=ada.headers).json()
    assert listed == {"items": [recording], "next": None}


def test_a_recording_is_not_taken_from_under_a_run(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    recording = added(api, curator, forest["id"], upload(platform, curator)).json()["recording"]
    with platform.database.transaction() as session:
        run = Job(kind="sequence.process", owner_id=curator.user_id, sequence_id=forest["id"], state="running")
        run.id = run.root_id = "ab" * 16
        run.arguments = {"recording_id": recording["id"]}
        session.add(run)
    path = f"{URL}/{forest['id']}/recordings/{recording['id']}"
    answer = api.delete(path, headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (409, "recording_in_use")
    assert api.get(path, headers=curator.headers).status_code == 200


def test_a_deleted_recording_gives_its_bytes_back_and_stops_its_job(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    made, upload_id = sequence(api, ada), upload(platform, ada)
    with platform.database.transaction() as session:
        storage_quota.reserve(session, ada.user_id, 3, upload_id, "upload", 10)
    body = added(api, ada, made["id"], upload_id).json()
    path = f"{URL}/{made['id']}/recordings/{body['recording']['id']}"
    assert api.delete(path, headers=ada.headers).status_code == 204
    assert api.delete(path, headers=ada.headers).status_code == 404
    assert row_of(platform, body["job"]["id"]).state == "cancelled"
    with platform.database.reading() as session:
        assert storage_quota.balance(session, ada.user_id) == 0
    again = added(api, ada, made["id"], upload_id)
    assert again.json()["code"] == "wrong_upload_state", "an upload serves once, even then"


SPLIT = {"run_1.mcap": b"second", "run_0.mcap": b"first", "metadata.yaml": b"list"}


def sealed(api: httpx.Client, owner: Person, sequence_id: str, body: Mapping[str, Any]) -> httpx.Response:
    return api.post(f"{URL}/{sequence_id}/recordings", json=dict(body), headers=owner.headers)


def uploads(platform: Platform, owner: Person, files: Mapping[str, bytes] = SPLIT) -> list[str]:
    return [upload(platform, owner, content, filename=name) for name, content in files.items()]


def states(platform: Platform, upload_ids: list[str]) -> set[str]:
    with platform.database.reading() as session:
        return {session.get_one(Upload, upload_id).state for upload_id in upload_ids}


def test_the_files_of_a_bag_become_one_recording_and_one_job(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    made, upload_ids = sequence(api, ada), uploads(platform, ada)
    answer = sealed(api, ada, made["id"], {"upload_ids": upload_ids, "name": "Feldweg 3"})
    assert answer.status_code == 202, answer.text
    recording, job = answer.json()["recording"], answer.json()["job"]
    digests = {name: sha256(content).hexdigest() for name, content in SPLIT.items()}
    lines = "".join(f"{digests[name]}  {name}\n" for name in sorted(SPLIT))
    assert (recording["filename"], recording["size_bytes"]) == ("Feldweg 3", sum(map(len, SPLIT.values())))
    assert recording["sha256"] == sha256(lines.encode()).hexdigest()
    assert [(file["filename"], file["sha256"]) for file in recording["files"]] == sorted(digests.items())
    assert {file["upload_id"] for file in recording["files"]} == set(upload_ids)
    assert row_of(platform, job["id"]).arguments == {"recording_id": recording["id"]}
    assert states(platform, upload_ids) == {"consumed"}
    shown = api.get(answer.headers["location"], headers=ada.headers).json()
    assert shown["files"] == recording["files"]


def test_files_that_are_not_one_bag_are_refused_and_kept(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    for files, why in [
        ({"a.mcap": b"1", "b.db3": b"2"}, "the files have several formats: .db3, .mcap"),
        ({"a.mcap": b"1", "b.db3-wal": b"2"}, "'b.db3-wal' was sent without 'b.db3'"),
    ]:
        upload_ids = uploads(platform, curator, files)
        answer = sealed(api, curator, forest["id"], {"upload_ids": upload_ids, "name": "run"})
        assert (answer.status_code, answer.json()["code"]) == (422, "bad_recording_files")
        assert why in answer.json()["detail"]
        assert states(platform, upload_ids) == {"complete"}


def test_somebody_elses_file_in_the_group_does_not_exist(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    theirs = upload(platform, person(platform, "curator"), b"secret", filename="run_2.mcap")
    upload_ids = uploads(platform, curator)
    answer = sealed(api, curator, forest["id"], {"upload_ids": [*upload_ids, theirs], "name": "run"})
    assert (answer.status_code, answer.json()["code"]) == (404, "upload_missing")
    assert states(platform, [*upload_ids, theirs]) == {"complete"}


def test_a_body_that_cannot_be_meant_is_refused(api: httpx.Client, curator: Person, forest: Mapping[str, Any]) -> None:
    for body in [
        {},
        {"upload_id": NOBODY, "upload_ids": [NOBODY, NOBODY], "name": "run"},
        {"upload_ids": [NOBODY], "name": "run"},
        {"upload_ids": [NOBODY, NOBODY]},
        {"upload_id": NOBODY, "name": "run"},
        {"upload_ids": [NOBODY, NOBODY], "name": "../run"},
        {"upload_ids": [NOBODY, NOBODY], "name": ".."},
        {"upload_ids": [NOBODY, NOBODY], "name": "a\u202eb"},
        {"upload_ids": [NOBODY] * (MOST_FILES + 1), "name": "run"},
    ]:
        assert sealed(api, curator, forest["id"], body).status_code == 422


def test_a_deleted_group_gives_the_bytes_of_every_file_back(api: httpx.Client, platform: Platform) -> None:
    ada = person(platform, "curator")
    made, upload_ids = sequence(api, ada), uploads(platform, ada)
    with platform.database.transaction() as session:
        for upload_id in upload_ids:
            storage_quota.reserve(session, ada.user_id, 5, upload_id, "upload", 100)
    recording = sealed(api, ada, made["id"], {"upload_ids": upload_ids, "name": "run"}).json()["recording"]
    path = f"{URL}/{made['id']}/recordings/{recording['id']}"
    assert api.delete(path, headers=ada.headers).status_code == 204
    with platform.database.reading() as session:
        assert storage_quota.balance(session, ada.user_id) == 0


@pytest.fixture
def driven(api: httpx.Client, platform: Platform, curator: Person) -> dict[str, Any]:
    """A sequence with a calibration and two registered recordings."""
    made = sequence(api, curator)
    rig = platform.settings.root / "rig.yaml"
    rig.write_text("stone_calibration: 1\n")
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, rig)
        row = CalibrationRow(
            owner_id=curator.user_id, name="rig", version=1, filename="rig.yaml", sensors=[], findings=[]
        )
        row.sha256 = row.blob_sha256 = blob.sha256
        session.add(row)
        session.flush()
        session.get_one(SequenceRow, made["id"]).calibration_id = row.id
    ids = [registered(platform, curator, made["id"], name) for name in ("lidar.mcap", "cameras.mcap")]
    return {**made, "recording_ids": ids}


def registered(platform: Platform, owner: Person, sequence_id: str, name: str) -> str:
    upload_id = upload(platform, owner, name.encode(), filename=name, state="consumed")
    with platform.database.transaction() as session:
        row = recording_of(session.get_one(Upload, upload_id), sequence_id, "registered")
        row.sha256 = name.encode().hex().ljust(64, "0")
        session.add(row)
        session.flush()
        return row.id


def processed(api: httpx.Client, owner: Person, sequence_id: str, **body: Any) -> httpx.Response:
    return api.post(f"{URL}/{sequence_id}/process", json=body, headers=owner.headers)


def test_what_is_none_of_the_sequences_is_refused_by_its_code(
    api: httpx.Client, platform: Platform, curator: Person, driven: dict[str, Any]
) -> None:
    unknown = processed(api, curator, driven["id"], recording_ids=["ab" * 16])
    assert (unknown.status_code, unknown.json()["code"]) == (409, "unknown_recording")
    shifted = processed(api, curator, driven["id"], clock_offsets_s={"radar.bag": 0.1})
    assert (shifted.status_code, shifted.json()["code"]) == (422, "bad_clock_offset")
    registered(platform, curator, driven["id"], "LIDAR.mcap")
    alike = processed(api, curator, driven["id"])
    assert (alike.status_code, alike.json()["code"]) == (409, "recordings_named_alike")


@pytest.mark.parametrize(("below_m", "is_refused"), [(2.157, True), (1.95, False)])
def test_a_ground_far_off_the_ego_origin_is_refused_before_a_run_begins_unless_it_is_to_be_corrected(
    api: httpx.Client, platform: Platform, curator: Person, driven: dict[str, Any], below_m: float, is_refused: bool
) -> None:
    """The LiDAR is 1.757 m above the ego origin by the calibration; what is 0.2 m off is for the run to measure."""
    kitti = Path(__file__).parents[2] / "examples" / "kitti0005.calibration.yaml"
    ground = {"sweeps": 40, "height_m": -below_m, "low_m": 0.02 - below_m, "high_m": 0.02 - below_m}
    ground |= {"slope_x": 0.0, "slope_y": 0.0, "map_slope_x": None, "map_slope_y": None}
    with platform.database.transaction() as session:
        blob = keep(session, platform.store, kitti)
        row = session.get_one(CalibrationRow, session.get_one(SequenceRow, driven["id"]).calibration_id)
        row.blob_sha256, row.filename = blob.sha256, kitti.name
        session.get_one(Recording, driven["recording_ids"][0]).inspection = {"lidar_ground": ground}
    answer = processed(api, curator, driven["id"])
    if is_refused:
        assert (answer.status_code, answer.json()["code"]) == (409, "footprint_off_ground")
        assert "0.40 m below the ego origin" in answer.json()["detail"]
        assert ", 2.157] m" in answer.json()["detail"]
        for body in ({"stages": ["synchronise"]}, {"recording_ids": driven["recording_ids"]}, {"ground": "auto"}):
            answer = processed(api, curator, driven["id"], **body)
            assert answer.status_code == 202
            with platform.database.transaction() as session:
                cancel(session, answer.json()["id"], "")
    else:
        assert answer.status_code == 202


def test_offsets_are_given_in_seconds_and_kept_in_nanoseconds(
    api: httpx.Client, platform: Platform, curator: Person, driven: dict[str, Any]
) -> None:
    cameras = driven["recording_ids"][1]
    answer = processed(api, curator, driven["id"], clock_offsets_s={cameras: "-110054594.750000001"})
    assert answer.status_code == 202
    with platform.database.reading() as session:
        arguments = session.get_one(Job, answer.json()["id"]).arguments
    assert arguments["clock_offsets_ns"] == {"cameras.mcap": -110_054_594_750_000_001}
    assert arguments["recording_ids"] == driven["recording_ids"]


def test_the_owner_is_told_that_labels_are_older_than_recordings_until_they_are_made_again(
    api: httpx.Client, platform: Platform, curator: Person, participant: Person, driven: dict[str, Any]
) -> None:
    def told(who: Person) -> Any:
        return api.get(f"{URL}/{driven['id']}", headers=who.headers).json()["later_recordings"]

    def labelled(job_id: str) -> None:
        with platform.database.transaction() as session:
            run = cancel(session, job_id, "")
            run.state = "succeeded"
            row = LabelSet(sequence_id=driven["id"], job_id=job_id, recipe=run.arguments["recipe"], parameters={})
            row.code_version, row.frames = "0", 1
            session.add(row)

    labelled(processed(api, curator, driven["id"]).json()["id"])
    assert told(curator) is None
    registered(platform, curator, driven["id"], "radar.bag")
    with platform.database.transaction() as session:
        session.get_one(SequenceRow, driven["id"]).is_public = True
    assert told(curator) == {"names": ["radar.bag"], "why_not": ""}
    assert told(participant) is None
    assert follow_recordings(platform) == 1
    shown = api.get(f"{URL}/{driven['id']}", headers=curator.headers).json()
    assert (shown["job"]["kind"], shown["job"]["state"]) == (PROCESS, "queued")
    assert told(curator) == {"names": ["radar.bag"], "why_not": ""}
    labelled(shown["job"]["id"])
    assert told(curator) is None


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


def test_a_recording_that_was_not_read_has_no_roles_yet(
    api: httpx.Client, platform: Platform, curator: Person, roles: str
) -> None:
    sequence_id = roles.split("/")[4]
    pending = added(api, curator, sequence_id, upload(platform, curator)).json()["recording"]["id"]
    for recording_id, status in ((pending, 409), (NOBODY, 404)):
        path = f"/api/v1/sequences/{sequence_id}/recordings/{recording_id}/roles"
        assert api.get(path, headers=curator.headers).status_code == status


def test_a_bag_in_place_is_taken_by_the_words_of_its_place_alone(
    platform: Platform, curator: Person, tmp_path: Path
) -> None:
    placed = having(platform, in_place={"folders": f"nas={tmp_path}"})
    with client_of(placed) as api:
        forest = sequence(api, curator)
        url = f"{URL}/{forest['id']}/recordings"
        roots = api.get("/api/v1/recording-roots", headers=curator.headers)
        assert (roots.json(), str(tmp_path) in roots.text) == ({"roots": ["nas"]}, False)
        for place, code in (
            ({"root": "disk", "path": "run.mcap"}, "unknown_root"),
            ({"root": "nas", "path": "../run.mcap"}, "bad_place"),
            ({"root": "nas", "path": "/etc/passwd"}, "bad_place"),
        ):
            answer = api.post(url, json={"in_place": place}, headers=curator.headers)
            assert (answer.status_code, answer.json()["code"]) == (422, code)
        both = {"in_place": {"root": "nas", "path": "run.mcap"}, "upload_id": NOBODY}
        assert api.post(url, json=both, headers=curator.headers).status_code == 422
        answer = api.post(url, json={"in_place": both["in_place"]}, headers=curator.headers)
        assert answer.status_code == 202
        made = answer.json()["recording"]
        assert (made["state"], made["filename"], made["place"]) == ("received", "run.mcap", both["in_place"])
