"""What everybody reads of a phase: by what it is scored, which frames, how the metric is defined, who sees what."""

import io
import json
import zipfile
from pathlib import Path

import httpx
import pytest
from sqlalchemy import select, update

from services.domain.benchmarks.golden import golden_names
from services.runtime.orm import GroundTruthRow, Phase
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.metric import METRIC_VERSION, METRICS
from stone_submissions.manifest import read_manifest
from testing.api.serving import Person
from testing.worlds.benchmark_world import benchmark_world
from tests.api.benchmark_calls import V1, made, problem
from tests.services.domain.benchmarks import laid


@pytest.fixture
def version(platform: Platform, administrator: Person) -> str:
    """The name of a version with a sequence in val and in test."""
    return laid.bare_version(platform, administrator).name


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


def test_who_may_see_what_is_told_in_words_that_follow_the_phase(
    api: httpx.Client, platform: Platform, administrator: Person, participant: Person, version: str
) -> None:
    phases = made(api, administrator, version)

    def told(name: str) -> list[str]:
        shown = api.get(f"{V1}/phases/{phases[name]['id']}", headers=participant.headers).json()
        visibility: list[str] = shown["visibility"]
        return visibility

    assert told("val")[0].startswith("The ground truth is open: everyone: totals rounded")
    assert told("test")[0].startswith("The ground truth is hidden and the phase has not ended")
    with platform.database.transaction() as session:
        session.execute(update(Phase).values(closes_ns=now_ns() - 1, named_from_ns=now_ns() + 10**12))
    assert [sentence.partition(":")[0] for sentence in told("test")[:1]] == [
        "The ground truth is hidden and the phase has ended"
    ]
    assert told("test")[-1].startswith("Until named_from_at")
