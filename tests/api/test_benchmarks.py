"""Benchmarks over the wire: made by administrators who say why, read by everybody, changed by who has read them."""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import httpx
import pytest
from sqlalchemy import select, update

from services.domain.benchmarks.golden import golden_names
from services.runtime.orm import AuditEntry, GroundTruthRow, Job, Phase
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION, METRICS
from stone_submissions.manifest import read_manifest
from testing.api.serving import Person
from testing.worlds.benchmark_world import benchmark_world
from tests.api.benchmark_calls import ADMIN, PAPER, V1, WHY, change, made, make, problem
from tests.services.domain.benchmarks import laid


@pytest.fixture
def version(platform: Platform, administrator: Person) -> str:
    """The name of a version with a sequence in val and in test."""
    return laid.bare_version(platform, administrator).name


def test_a_benchmark_of_a_version_has_an_open_val_and_a_hidden_test(
    api: httpx.Client, administrator: Person, participant: Person, version: str
) -> None:
    phases = made(api, administrator, version)
    assert {name: (one["part"], one["is_hidden"], one["findings"]) for name, one in phases.items()} == {
        "val": ("val", False, []),
        "test": ("test", True, []),
    }
    shown = api.get(f"{V1}/benchmarks/stone", headers=participant.headers).json()
    assert (shown["title"], shown["description"]) == ("STONE", "Traversability of voxels\nIn 3D.")
    assert [phase["id"] for phase in shown["phases"]] == [phases["test"]["id"], phases["val"]["id"]]
    assert "findings" not in shown["phases"][0]
    listed = api.get(f"{V1}/benchmarks", headers=participant.headers).json()
    assert [(item["name"], item["phases"]) for item in listed["items"]] == [("stone", ["test", "val"])]


def phase_like(**said: Any) -> dict[str, Any]:
    """What makes a benchmark of one phase over val, but for what is said."""
    return {"phases": [{"name": "v", "part": "val", "is_hidden": False, **said}]}


NO_BENCHMARKS: tuple[tuple[dict[str, Any], tuple[int, str]], ...] = (
    ({"name": "Stone"}, (422, "invalid_request")),
    ({"name": "a/b"}, (422, "invalid_request")),
    ({"title": "a\u202eb"}, (422, "invalid_request")),
    ({"description": "a\x07b"}, (422, "invalid_request")),
    ({"reason": " "}, (422, "invalid_request")),
    ({"dataset": "never-published"}, (404, "not_found")),
    ({"phases": []}, (422, "invalid_request")),
    ({"phases": phase_like()["phases"] * 2}, (409, "name_taken")),
    (phase_like(part="test"), (409, "open_test")),
    (phase_like(part="train", is_hidden=True), (409, "empty_part")),
    (phase_like(every_nth=2), (422, "bad_phase")),
    (phase_like(mask="radar"), (422, "invalid_request")),
    (phase_like(opens_at="2026-06-01"), (422, "invalid_request")),
    (phase_like(opens_at="2026-06-01T00:00:00"), (422, "invalid_request")),
)


def test_what_makes_no_benchmark_is_refused_and_leaves_none(
    api: httpx.Client, administrator: Person, version: str
) -> None:
    for said, refusal in NO_BENCHMARKS:
        assert problem(make(api, administrator, version, **said)) == refusal, said
        assert api.get(f"{V1}/benchmarks", headers=administrator.headers).json()["items"] == []


def test_a_phase_is_changed_by_whom_has_read_it(api: httpx.Client, administrator: Person, version: str) -> None:
    phase = made(api, administrator, version)["test"]
    tag = api.get(f"{V1}/phases/{phase['id']}", headers=administrator.headers).headers["etag"]
    assert problem(change(api, administrator, phase, "", title="x")) == (428, "precondition_required")
    closes = {"closes_at": "2026-10-01T02:00:00+02:00", "scorings_total": 40}
    changed = change(api, administrator, phase, tag, **closes, window_s=86400)
    assert changed.status_code == 200
    assert {name: changed.json()[name] for name in ("closes_at", "scorings_total", "window_s", "revision")} == {
        "closes_at": "2026-10-01T00:00:00Z",
        "scorings_total": 40,
        "window_s": 86400,
        "revision": 2,
    }
    assert problem(change(api, administrator, phase, tag, title="x")) == (412, "precondition_failed")
    never = change(api, administrator, phase, tag, opens_at="1900-01-01T00:00:00Z")
    assert [one["detail"] for one in never.json()["errors"]] == ["the year is 1900; expected 1970 to 2200"]
    freed = change(api, administrator, phase, changed.headers["etag"], closes_at=None, scorings_total=None, title=None)
    assert (freed.json()["closes_at"], freed.json()["scorings_total"]) == (None, None)
    assert freed.json()["title"] == phase["title"]


def test_a_phase_shows_that_it_keeps_order_back_and_not_by_which_key(
    api: httpx.Client, platform: Platform, administrator: Person, participant: Person, version: str
) -> None:
    asked = {"phases": [{"name": "test", "part": "test", "is_hidden": True, "every_nth": 5}]}
    assert make(api, administrator, version, **asked).status_code == 201
    (key,) = (row.token_key for row in laid.rows(platform, select(Phase)))
    for person in (administrator, participant):
        for path in ("/benchmarks/stone", "/benchmarks/stone/phases/test"):
            shown = api.get(f"{V1}{path}", headers=person.headers)
            assert '"every_nth":5' in shown.text
            assert key not in shown.text


NO_CHANGES: tuple[tuple[dict[str, Any], tuple[int, str]], ...] = (
    ({"closes_at": "2026-06-01T00:00:00Z", "opens_at": "2026-06-01T00:00:00Z"}, (422, "bad_phase")),
    ({"is_hidden": False}, (409, "open_test")),
    ({"part": "train"}, (409, "empty_part")),
    ({"dataset": "never-published"}, (404, "not_found")),
    ({"closes_at": "9999-01-01T00:00:00Z"}, (422, "invalid_request")),
    ({"team_members": 0}, (422, "invalid_request")),
    ({"every_nth": 2}, (422, "invalid_request")),
    ({"reason": ""}, (422, "invalid_request")),
)


def test_a_change_that_contradicts_itself_is_refused(api: httpx.Client, administrator: Person, version: str) -> None:
    phase = made(api, administrator, version)["test"]
    for said, refusal in NO_CHANGES:
        assert problem(change(api, administrator, phase, **said)) == refusal, said
        assert api.get(f"{V1}/phases/{phase['id']}", headers=administrator.headers).json()["revision"] == 1


def test_every_act_is_in_the_audit_log_with_its_reason(
    api: httpx.Client, platform: Platform, administrator: Person, version: str
) -> None:
    phase = made(api, administrator, version)["test"]
    change(api, administrator, phase, scorings_total=7, reason="fewer")
    api.post(f"{ADMIN}/phases/{phase['id']}/ground-truths", json=WHY, headers=administrator.headers)
    api.put(f"{ADMIN}/phases/{phase['id']}/reported", json={"rows": [PAPER], **WHY}, headers=administrator.headers)
    acts = {row.act: row for row in laid.rows(platform, select(AuditEntry))}
    assert set(acts) == {"benchmark.create", "phase.change", "ground_truth.create", "reported.put"}
    assert {row.reason for act, row in acts.items() if act != "phase.change"} == {WHY["reason"]}
    assert (acts["phase.change"].reason, acts["phase.change"].facts) == (
        "fewer",
        {"scorings_total": {"from": None, "to": 7}},
    )


def test_a_ground_truth_is_asked_for_once_at_a_time_and_fixes_what_is_evaluated(
    api: httpx.Client, platform: Platform, administrator: Person, version: str
) -> None:
    phase = made(api, administrator, version)["test"]
    path = f"{ADMIN}/phases/{phase['id']}/ground-truths"
    asked = api.post(path, json=WHY, headers=administrator.headers)
    assert asked.status_code == 202
    truth = asked.json()["ground_truth"]
    assert (truth["number"], truth["state"], truth["sha256"], truth["dataset"]) == (1, "making", None, version)
    assert asked.headers["location"] == f"{V1}/jobs/{truth['job_id']}"
    assert problem(api.post(path, json=WHY, headers=administrator.headers)) == (409, "truth_in_making")
    assert problem(change(api, administrator, phase, mask="lidar")) == (409, "phase_fixed")
    with platform.database.transaction() as session:
        session.execute(update(Job).values(state="cancelled"))
    listed = api.get(path, headers=administrator.headers).json()["items"]
    assert [(item["number"], item["state"]) for item in listed] == [(1, "failed")]
    assert change(api, administrator, phase, mask="lidar").status_code == 200


def test_reported_rows_are_put_as_a_whole_and_read_as_they_are_put(
    api: httpx.Client, administrator: Person, version: str
) -> None:
    path = f"{ADMIN}/phases/{made(api, administrator, version)['test']['id']}/reported"
    whole = {**PAPER, "iou_occ": None, "iou_t": None, "iou_p": None, "iou_n": None, "note": "", "percent_digits": 2,
             "kind": "published"}  # fmt: skip
    for _ in range(2):
        put = api.put(path, json={"rows": [PAPER], **WHY}, headers=administrator.headers)
        assert (put.status_code, put.json()) == (200, {"items": [whole], "next": None})
    assert api.get(path, headers=administrator.headers).json()["items"] == [whole]
    noted = whole | {"note": "of another split", "percent_digits": 1}
    ceiling = noted | {"kind": "ceiling"}
    for rows in ([noted], [ceiling], [noted]):
        assert api.put(path, json={"rows": rows, **WHY}, headers=administrator.headers).json()["items"] == rows
    assert api.put(path, json={"rows": [], **WHY}, headers=administrator.headers).json()["items"] == []


def test_who_has_read_the_reported_rows_writes_over_nobody_elses(
    api: httpx.Client, administrator: Person, version: str
) -> None:
    path = f"{ADMIN}/phases/{made(api, administrator, version)['test']['id']}/reported"
    tag = api.get(path, headers=administrator.headers).headers["etag"]
    read = administrator.headers | {"If-Match": tag}
    assert api.put(path, json={"rows": [PAPER], **WHY}, headers=read).status_code == 200
    assert problem(api.put(path, json={"rows": [], **WHY}, headers=read)) == (412, "precondition_failed")
    again = api.get(path, headers=administrator.headers)
    assert [row["method"] for row in again.json()["items"]] == [PAPER["method"]]
    read = administrator.headers | {"If-Match": again.headers["etag"]}
    assert api.put(path, json={"rows": [], **WHY}, headers=read).json()["items"] == []


NO_ROWS: tuple[tuple[dict[str, Any], str], ...] = (
    ({"miou": 25.0}, "invalid_request"), ({"miou": -0.1}, "invalid_request"), ({"modality": "L+C"}, "invalid_request"),
    ({"method": ""}, "invalid_request"), ({"source": "a\u200bb"}, "invalid_request"), ({"rank": 1}, "invalid_request"),
    ({"note": "a\u202eb"}, "invalid_request"), ({"note": "a" * 601}, "invalid_request"),
    ({"percent_digits": 5}, "invalid_request"), ({"kind": "floor"}, "invalid_request"), ({}, "reported_twice"),
)  # fmt: skip


def test_a_row_that_cannot_be_a_result_is_refused(api: httpx.Client, administrator: Person, version: str) -> None:
    path = f"{ADMIN}/phases/{made(api, administrator, version)['test']['id']}/reported"
    for row, code in NO_ROWS:
        answer = api.put(path, json={"rows": [PAPER, PAPER | row], **WHY}, headers=administrator.headers)
        assert problem(answer) == (422, code), row
    assert api.get(path, headers=administrator.headers).json()["items"] == []


def test_without_a_ground_truth_there_is_no_manifest(
    api: httpx.Client, administrator: Person, participant: Person, version: str
) -> None:
    made(api, administrator, version)
    answer = api.get(f"{V1}/benchmarks/stone/phases/test/manifest", headers=participant.headers)
    assert problem(answer) == (409, "no_ground_truth")


def test_the_metric_is_told_as_text_and_with_golden_vectors(
    api: httpx.Client, administrator: Person, participant: Person, version: str
) -> None:
    made(api, administrator, version)
    path = f"{V1}/benchmarks/stone/phases/val/metrics"
    for name, metric in METRICS.items():
        told = api.get(f"{path}/{name}", headers=participant.headers)
        expected = {"version": name, "title": metric.title, "definition": metric.definition, "is_active": False}
        assert told.json() == expected
        text = api.get(f"{path}/{name}?format=markdown", headers=participant.headers)
        assert (text.text, text.headers["content-type"]) == (metric.definition, "text/markdown; charset=utf-8")
        vectors = api.get(f"{path}/{name}/vectors", headers=participant.headers)
        with zipfile.ZipFile(io.BytesIO(vectors.content)) as archive:
            assert archive.testzip() is None
            assert tuple(archive.namelist()) == golden_names()
            assert json.loads(archive.read("expected.json"))["golden"] == 1
    for unknown in (f"{path}/stone-iou-0", f"{path}/stone-iou-0/vectors"):
        assert problem(api.get(unknown, headers=participant.headers)) == (404, "not_found")


def test_a_phase_that_is_scored_tells_by_what_and_which_frames(
    api: httpx.Client, platform: Platform, tmp_path: Path
) -> None:
    world = benchmark_world(platform, frames=1)
    headers = world.captains[0].headers
    for part in ("val", "test"):
        path = f"{V1}/benchmarks/{world.benchmark}/phases/{part}"
        phase = api.get(path, headers=headers).json()
        truth = laid.rows(platform, select(GroundTruthRow).where(GroundTruthRow.phase_id == phase["id"]))[0]
        active = phase["active"]
        assert active["signature"] == {"metric": METRIC_VERSION, "ground_truth": truth.sha256, "mask": "all"}
        assert (active["ground_truth"], active["frames"], active["dataset"]) == (
            1,
            len(world.truth(part)),
            world.dataset,
        )
        manifest = api.get(f"{path}/manifest", headers=headers)
        assert manifest.headers["etag"] == f'"{active["manifest_sha256"]}"'
        unchanged = api.get(f"{path}/manifest", headers=headers | {"If-None-Match": manifest.headers["etag"]})
        assert unchanged.status_code == 304
        (tmp_path / "manifest.json").write_bytes(manifest.content)
        assert set(read_manifest(tmp_path / "manifest.json").tokens) == set(world.truth(part))
        assert api.get(f"{path}/metrics/{METRIC_VERSION}", headers=headers).json()["is_active"]
