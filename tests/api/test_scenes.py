"""What the viewer is given over HTTP: to whoever may look at the sequence, to nobody else, and no stale byte of it."""

import json
from collections.abc import Mapping
from typing import Any

import httpx
import numpy as np
import pytest
from sqlalchemy import update

from services.domain.viewer.formats import MEDIA_TYPES
from services.domain.viewer.playback import INDEX, camera_file
from services.runtime.jobs.control import cancel
from services.runtime.orm import Artefact, Export, SequenceRow
from services.runtime.platform import Platform
from testing.api.serving import Person
from testing.worlds.benchmark_world import benchmark_world
from testing.worlds.made import Labels, frame_labels, labels, playback, run, sequence
from testing.worlds.viewer_cameras import played as with_playback
from tests.services.runtime.view_decoding import Read

URL = "/api/v1"


@pytest.fixture
def forest(api: httpx.Client, curator: Person) -> dict[str, Any]:
    return sequence(api, curator)


@pytest.fixture
def made(platform: Platform, forest: Mapping[str, Any]) -> Labels:
    return labels(platform, forest, contents=[frame_labels(kind) for kind in (1, 2, 3)])


def scene(api: httpx.Client, caller: Person, forest: Mapping[str, Any]) -> dict[str, Any]:
    answer = api.get(f"{URL}/sequences/{forest['id']}/scene", headers=caller.headers)
    assert answer.status_code == 200, answer.text
    shown: dict[str, Any] = answer.json()
    return shown


def paths_of(forest: Mapping[str, Any], made: Labels) -> list[str]:
    frame, of_sequence = f"{URL}/frames/{next(iter(made.frames))}", f"{URL}/sequences/{forest['id']}"
    of_frame = [f"{frame}/{part}" for part in ("voxels", "bev.png", "camera/CAM_FRONT.jpg", "cloud", "radar")]
    return [*of_frame, *(f"{of_sequence}/scene{part}" for part in ("", "/tiles/0_-1", "/meshes/0_-1", "/cameras"))]


def make_public(platform: Platform) -> None:
    with platform.database.transaction() as session:
        session.execute(update(SequenceRow).values(is_public=True))


def test_labels_of_an_earlier_version_have_no_scene_and_say_what_to_do(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    with platform.database.transaction() as session:
        session.execute(update(Artefact).where(Artefact.name == "scene/scene.json").values(name="scene/scene.old"))
    answer = api.get(f"{URL}/sequences/{forest['id']}/scene", headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "no_scene")
    assert "process the sequence again" in answer.json()["detail"]


def test_a_tile_that_is_not_there_is_404(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    for kind in ["tiles", "meshes"]:
        for name in ["0_0", "0_-01", "99_99"]:
            path = f"{URL}/sequences/{forest['id']}/scene/{kind}/{name}"
            assert api.get(path, headers=curator.headers).status_code == 404
            assert api.get(f"{path}.bin", headers=curator.headers).status_code == 422


def test_pictures_are_404_until_the_playback_is_ready_and_the_scene_tells_how_far_it_is(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    camera = paths_of(forest, made)[2]

    def state() -> tuple[str, int, str]:
        answer = api.get(camera, headers=curator.headers)
        code = answer.json()["code"] if answer.status_code == 404 else ""
        return scene(api, curator, forest)["playback"]["state"], answer.status_code, code

    assert state() == ("none", 404, "no_playback")
    asked = api.post(f"{URL}/sequences/{forest['id']}/exports", json={"format": "playback"}, headers=curator.headers)
    assert asked.status_code == 409, "its recording was never brought"
    job_id = run(platform, curator, "labeler.ok", sequence_id=forest["id"])
    with platform.database.transaction() as session:
        facts = {"sequence_id": forest["id"], "label_set_id": made.id, "format": "playback", "recipe": "0" * 64}
        session.add(Export(job_id=job_id, code_version="1", **facts))
    assert state() == ("making", 404, "no_playback")
    with platform.database.transaction() as session:
        cancel(session, job_id, "enough")
    assert state() == ("none", 404, "no_playback")


@pytest.fixture
def played(platform: Platform, forest: Mapping[str, Any], made: Labels, curator: Person) -> Labels:
    """The same with a playback."""
    playback(platform, forest["id"], list(made.frames))
    return made


def test_the_scene_is_what_the_labeler_wrote_with_what_is_known_of_it_now(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], played: Labels
) -> None:
    shown = scene(api, curator, forest)
    kept = json.loads(played.files["scene/scene.json"])
    assert {key: shown[key] for key in kept} == {**kept, "grid": {"name": "paper", **kept["grid"]}}
    assert (shown["sequence_id"], shown["label_set_id"]) == (forest["id"], played.id)
    assert shown["playback"].pop("export_id")
    sensors = shown["playback"].pop("sensors")
    assert shown["playback"].pop("has_radars") is True
    assert shown["playback"] == {"state": "ready", "cameras": ["CAM_FRONT"], "has_clouds": True, "has_rays": True}
    assert sensors == [
        {"channel": "LIDAR_TOP", "kind": "lidar", "ego_from_sensor": [0.0, 0.0, 0.5, 1.0, 0.0, 0.0, 0.0]}
    ]


def test_tiles_surfaces_pictures_and_sweeps_are_the_files_that_were_made(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], played: Labels
) -> None:
    token = next(iter(played.frames))
    answers = [api.get(path, headers=curator.headers) for path in paths_of(forest, played)]
    assert [answer.status_code for answer in answers] == [200] * 9
    _, _, camera, cloud, radar, _, tile, mesh, cameras = answers
    assert (radar.content, radar.headers["content-type"]) == (b"STE1" + token.encode(), MEDIA_TYPES["STE1"])
    assert (camera.content, cloud.content) == (b"\xff\xd8" + token.encode(), b"STC1" + token.encode())
    assert (tile.content, mesh.content) == (played.files["scene/tile_0_-1.bin"], played.files["scene/mesh_0_-1.bin"])
    assert (camera.headers["content-type"], cloud.headers["content-type"]) == ("image/jpeg", MEDIA_TYPES["STC1"])
    assert (cameras.content, cameras.headers["content-type"]) == (b"STR1", MEDIA_TYPES["STR1"])


def test_the_voxels_of_a_frame_are_its_labels(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    index = (128 * 256 + 100) * 32 + 9
    for kind, token in enumerate(made.frames, 1):
        answer = api.get(f"{URL}/frames/{token}/voxels", headers=curator.headers)
        assert answer.headers["content-type"] == MEDIA_TYPES["STV1"]
        read = Read(answer.content, b"STV1")
        assert read.values("I", 1) == [3]
        low, high, seen = (np.array(read.values("B", 256 * 256 * 4), np.uint8) for _ in range(3))
        at = 1 << (index % 8)
        assert (np.flatnonzero(low | high).tolist(), low[index // 8], high[index // 8]) == (
            [index // 8], at * (kind & 1), at * (kind >> 1),
        )  # fmt: skip
        assert np.unpackbits(seen).sum() == 32


def test_what_names_its_labels_is_kept_for_good_and_what_does_not_is_asked_for_again(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], played: Labels
) -> None:
    export_id = scene(api, curator, forest)["playback"]["export_id"]
    for path in paths_of(forest, played):
        version = export_id if path.endswith("/cameras") else played.id
        plain = api.get(path, headers=curator.headers)
        same = api.get(path, headers={**curator.headers, "If-None-Match": plain.headers["etag"]})
        assert (same.status_code, same.content) == (304, b"")
        if path.endswith("/scene"):  # its address names no labels
            assert plain.headers["cache-control"] == "private, no-cache"
            continue
        named = api.get(path, params={"v": version}, headers=curator.headers)
        other = api.get(path, params={"v": "0" * 32}, headers=curator.headers)
        assert plain.content == named.content == other.content
        assert plain.headers["cache-control"] == other.headers["cache-control"] == "private, no-cache"
        assert named.headers["vary"] == "Authorization, Cookie"
        assert named.headers["cache-control"] == "private, max-age=31536000, immutable"
    newer = labels(platform, forest, contents=[frame_labels(3)] * 3, seed=b"n")
    path = paths_of(forest, newer)[0]
    stale = api.get(path, params={"v": played.id}, headers=curator.headers)
    assert stale.headers["cache-control"] == "private, no-cache", "the address means labels that no longer count"
    assert scene(api, curator, forest)["playback"]["state"] == "none"


def test_what_is_public_is_played_to_visitors_and_its_exports_stay_the_owners(
    api: httpx.Client, platform: Platform, participant: Person, forest: Mapping[str, Any], played: Labels
) -> None:
    paths = paths_of(forest, played)
    assert {api.get(path).status_code for path in paths} == {401}
    assert {api.get(path, headers=participant.headers).status_code for path in paths} == {404}
    make_public(platform)
    for headers in ({}, participant.headers):
        assert {api.get(path, headers=headers).status_code for path in paths} == {200}
    export_id = api.get(paths[5]).json()["playback"]["export_id"]
    of_export = f"{URL}/sequences/{forest['id']}/exports/{export_id}"
    for path in (of_export, f"{of_export}/files", f"{of_export}/archive", f"{of_export}/files/playback.json"):
        assert (api.get(path).status_code, api.get(path, headers=participant.headers).status_code) == (401, 404)


def test_a_playback_of_an_earlier_release_has_pictures_and_no_cameras_to_look_through(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any], made: Labels
) -> None:
    index = json.dumps({"cameras": ["CAM_FRONT"], "has_clouds": False}).encode()
    token = next(iter(made.frames))
    with_playback(platform, curator, forest["id"], {INDEX: index, camera_file("CAM_FRONT", token): b"\xff\xd8"})
    shown = scene(api, curator, forest)["playback"]
    assert (shown["has_rays"], shown["has_radars"], shown["sensors"]) == (False, False, [])
    answer = api.get(f"{URL}/sequences/{forest['id']}/scene/cameras", headers=curator.headers)
    assert (answer.status_code, answer.json()["code"]) == (404, "not_found")


def test_labels_are_not_kept_for_good_in_pictures_that_can_be_made_anew(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], played: Labels
) -> None:
    path = f"{URL}/sequences/{forest['id']}/scene/cameras"
    answer = api.get(path, params={"v": played.id}, headers=curator.headers)
    assert answer.headers["cache-control"] == "private, no-cache"


def test_a_camera_that_took_no_picture_of_a_frame_is_404(
    api: httpx.Client, curator: Person, forest: Mapping[str, Any], played: Labels
) -> None:
    frame = f"{URL}/frames/{next(iter(played.frames))}"
    assert api.get(f"{frame}/camera/CAM_BACK.jpg", headers=curator.headers).json()["code"] == "not_found"
    assert api.get(f"{frame}/camera/..%2Fcam.jpg", headers=curator.headers).status_code in (404, 422)


@pytest.mark.whole
def test_a_public_sequence_of_a_hidden_phase_is_played_to_nobody_but_its_owner(
    api: httpx.Client, platform: Platform
) -> None:
    world = benchmark_world(platform)
    make_public(platform)
    token, seen = next(iter(world.truth("test"))), next(iter(world.truth("val")))
    for part in ("labels.npz", "voxels", "bev.png", "cloud", "camera/CAM_FRONT.jpg"):
        path = f"{URL}/frames/{token}/{part}"
        assert api.get(path).status_code == 401
        refused = api.get(path, headers=world.captains[0].headers)
        assert (refused.status_code, refused.json()["code"]) == (404, "not_found")
    assert api.get(f"{URL}/frames/{seen}/voxels").status_code == 200
    callers: tuple[Mapping[str, str], ...] = ({}, world.captains[0].headers, world.curator.headers)
    for headers in callers[:2]:
        shown = {one["name"] for one in api.get(f"{URL}/sequences", headers=headers).json()["items"]}
        assert shown == set(world.grids["train"]) | set(world.grids["val"])
    listed = api.get(f"{URL}/sequences", headers=world.curator.headers).json()["items"]
    sequences = {one["name"]: one["id"] for one in listed}
    for part in ("", "/tiles/0_-1", "/meshes/0_-1"):
        for name in world.grids["test"]:
            path = f"{URL}/sequences/{sequences[name]}/scene{part}"
            statuses = [api.get(path, headers=one).status_code for one in callers]
            assert statuses == [401, 404, 200]


def test_labels_that_the_store_lost_are_a_fault_and_not_an_empty_world(
    api: httpx.Client, platform: Platform, curator: Person, forest: Mapping[str, Any]
) -> None:
    broken = labels(platform, forest, contents=[b"no labels at all"])
    answer = api.get(f"{URL}/frames/{next(iter(broken.frames))}/voxels", headers=curator.headers)
    assert answer.status_code == 500
