"""The main job by REST alone: bag and calibration in, labels out, all of it gone again.

Catches alone a way through the routes that ends before its labels are read, since everything else is put into the rows.
"""

import io
import json
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from services.ingest import queue_handlers as ingest
from services.labeler import queue_handlers as labeler
from services.runtime.access import storage_quota
from services.runtime.jobs.execution import run_next
from services.runtime.orm import Artefact, Blob, Export, ExportPack, LabelSet, Preview, Recording
from services.runtime.platform import Platform
from services.runtime.settings import Settings
from simulator.pipeline import calibration_path
from testing.api.serving import Person, client_of, person
from testing.servers.fixtures import opened
from testing.worlds.drives import drive
from testing.worlds.runs import SMALL, run_all

pytestmark = pytest.mark.everyday
API = "/api/v1"


@dataclass(frozen=True)
class Done:
    """A sequence that went the whole way, and what was answered on it."""

    api: httpx.Client
    platform: Platform
    owner: Person
    sequence: dict[str, Any]
    run: dict[str, Any]
    bag: Path

    def path(self, below: str = "") -> str:
        return f"{API}/sequences/{self.sequence['id']}{below}"

    def read(self, path: str, **headers: str) -> httpx.Response:
        return self.api.get(path, headers={key.replace("_", "-"): value for key, value in headers.items()})


def accepted(answer: httpx.Response, *statuses: int) -> Any:
    assert answer.status_code in statuses, answer.text
    return answer.json()


def brought(api: httpx.Client, platform: Platform, bag: Path) -> dict[str, Any]:
    """A sequence with its calibration and its recording, read; what is missing on the way is said."""
    made: dict[str, Any] = accepted(api.post(f"{API}/sequences", json={"name": "field"}), 201)
    path = f"{API}/sequences/{made['id']}"
    assert refused(api, path) == "no_calibration"
    file = {"file": (calibration_path(bag).name, calibration_path(bag).read_bytes())}
    rig = accepted(api.post(f"{API}/calibrations", files=file), 201)
    accepted(api.put(f"{path}/calibration", json={"calibration_id": rig["id"]}), 200)
    assert refused(api, path) == "no_recording"
    form = {"purpose": "recording", "target_id": made["id"]}
    with bag.open("rb") as content:
        sent = api.post(f"{API}/uploads/form", data=form, files={"file": (bag.name, content)})
    assert sent.status_code == 201, sent.text
    upload_id = sent.headers["location"].rpartition("/")[2]
    accepted(api.post(f"{path}/recordings", json={"upload_id": upload_id}), 202)
    assert refused(api, path) == "recording_pending"
    run_all(platform)
    return made


def refused(api: httpx.Client, path: str) -> str:
    """Why the sequence is not processed now."""
    answer = api.post(f"{path}/process", json={})
    assert answer.status_code == 409, answer.text
    return str(answer.json()["code"])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drive(tmp_path_factory, SMALL)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, _sqlite_template: Path, bag: Path) -> Iterator[Done]:
    settings = Settings(data_folder=tmp_path_factory.mktemp("main-job"))
    (settings.root / "stone.sqlite3").write_bytes(_sqlite_template.read_bytes())
    platform = opened(settings, [])
    owner = person(platform, "curator")
    with client_of(platform, owner) as api:
        made = brought(api, platform, bag)
        path = f"{API}/sequences/{made['id']}"
        run = accepted(api.post(f"{path}/process", json={"profile": "local"}), 202)
        again = accepted(api.post(f"{path}/process", json={"profile": "local"}), 202)
        assert again["id"] == run["id"], "equal requests are one run"
        other = api.post(f"{path}/process", json={"profile": "paper"})
        assert (other.status_code, other.json()["code"]) == (409, "already_processing")
        assert run["id"] in other.json()["detail"]
        run_all(platform)
        yield Done(api, platform, owner, made, run, bag)
    platform.database.close()


def test_the_recording_was_read_and_says_what_is_in_it(done: Done) -> None:
    (item,) = accepted(done.read(done.path("/recordings")), 200)["items"]
    assert (item["state"], item["sha256"]) == ("registered", sha256(done.bag.read_bytes()).hexdigest())
    shown = accepted(done.read(done.path(f"/recordings/{item['id']}")), 200)
    assert shown["inspection"]["topics"]


def test_the_run_succeeded_stage_by_stage(done: Done) -> None:
    run = accepted(done.read(f"{API}/jobs/{done.run['id']}"), 200)
    assert (run["state"], run["failure"]) == ("succeeded", None)
    assert all(stage["done"] == stage["total"] for stage in run["stages"])
    kinds = [stage["kind"] for stage in run["stages"]]
    assert (kinds[0], kinds[-1]) == ("ingest.synchronise", "labeler.publish")
    assert accepted(done.read(f"{API}/jobs/{run['id']}/logs"), 200)["items"]


def test_every_frame_has_its_labels(done: Done) -> None:
    frames = accepted(done.read(done.path("/frames"), **{}), 200)["items"]
    report = accepted(done.read(done.path("/report")), 200)
    assert len(frames) == min(report["frames"], 50) > 30
    for frame in (frames[0], frames[-1]):
        answer = done.read(f"{API}/frames/{frame['token']}/labels.npz")
        assert answer.headers["etag"] == f'"{sha256(answer.content).hexdigest()}"'
        labels = np.load(io.BytesIO(answer.content))
        assert set(labels) == {"semantics", "mask_lidar", "mask_camera", "late"}
        assert labels["semantics"].shape == (256, 256, 32)
        assert (labels["semantics"] == 1).any(), "the robot stands on what it drove over"


def test_files_are_those_the_sequence_names(done: Done) -> None:
    shown = accepted(done.read(done.path()), 200)
    paths = {"report.json": "/report", "mesh.ply": "/mesh", "bev.png": "/previews/bev.png",
             "map.png": "/previews/map.png", "features.png": "/previews/features.png",
             "thumbnail.png": "/previews/thumbnail.png",
             "frames.parquet": "/frames.parquet", "sequence.npz": "/sequence.npz",
             "grid.json": "/grid.json"}  # fmt: skip
    assert {file["name"] for file in shown["artefacts"]} == set(paths)
    for file in shown["artefacts"]:
        answer = done.read(done.path(paths[file["name"]]))
        assert (len(answer.content), answer.headers["content-type"]) == (file["size_bytes"], file["media_type"])
        assert sha256(answer.content).hexdigest() == file["sha256"]
    part = done.read(done.path("/mesh"), Range="bytes=0-3")
    assert (part.status_code, part.content) == (206, b"ply\n")
    assert json.loads(done.read(done.path("/report")).content)["parameters"]


def test_what_has_been_made_is_not_made_again(done: Done) -> None:
    again = accepted(done.api.post(done.path("/process"), json={"profile": "local"}), 202)
    assert (again["id"], again["state"]) == (done.run["id"], "succeeded")


def test_a_sequence_is_deleted_safely_while_its_jobs_run(platform: Platform, bag: Path) -> None:
    owner = person(platform, "curator")
    with client_of(platform, owner) as api:
        made = brought(api, platform, bag)
        path = f"{API}/sequences/{made['id']}"
        run = accepted(api.post(f"{path}/process", json={}), 202)
        for _ in range(2):
            assert run_next(platform, "ingest", ingest.handlers(platform)) or run_next(
                platform, "labeler", labeler.handlers(platform)
            )
        assert api.delete(path, headers={"If-Match": "*"}).status_code == 204
        run_all(platform)
        assert accepted(api.get(f"{API}/jobs/{run['id']}"), 200)["state"] == "cancelled"
        states = {item["state"] for item in api.get(f"{API}/jobs", params={"root_id": run["id"]}).json()["items"]}
        assert states <= {"succeeded", "cancelled"}
        assert api.get(path).status_code == 404
    with platform.database.reading() as session:
        assert session.query(LabelSet).count() == session.query(Recording).count() == 0
        assert storage_quota.balance(session, owner.user_id) == 0


def test_a_deleted_sequence_leaves_nothing_that_is_counted(done: Done) -> None:
    """The last of the module."""
    with done.platform.database.reading() as session:
        index = session.get_one(Blob, session.query(Export).one().index_sha256)
        playback_bytes = index.size_bytes + sum(pack.size_bytes for pack in session.query(ExportPack))
        of_labels = sum(one.size_bytes for one in session.query(Artefact))
        counted = done.bag.stat().st_size + playback_bytes + of_labels
        counted += sum(one.size_bytes for one in session.query(Preview))
        assert storage_quota.balance(session, done.owner.user_id) == counted
    assert done.api.delete(done.path(), headers={"If-Match": "*"}).status_code == 204
    with done.platform.database.reading() as session:
        assert session.query(LabelSet).count() == 0
        assert storage_quota.balance(session, done.owner.user_id) == 0
    run = accepted(done.read(f"{API}/jobs/{done.run['id']}"), 200)
    assert run["state"] == "succeeded", "what was done stays told"
