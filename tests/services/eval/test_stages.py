"""A submission that is sent in is scored as `stone score` scores it, once, whatever way its frames take."""

import json
from pathlib import Path

import numpy as np
import pytest
from sqlalchemy import func, select

from services.domain.benchmarks.submissions import scoring_ranges
from services.eval.pipeline import score
from services.eval.scored_case import truth_of
from services.runtime.jobs.enqueue import enqueue
from services.runtime.jobs.specs import Context, JobSpec
from services.runtime.orm import Blob, GroundTruthRow, Job, Upload, UploadPartRow
from services.runtime.settings import Settings, StoreSettings
from services.runtime.uploads.backends import StoreUploadBackend
from services.runtime.uploads.files import remove_file, upload_file
from stone.scoring.metric import RATIOS
from testing.refusals import refused_as
from testing.servers.fixtures import opened
from testing.worlds.benchmark_world import World, benchmark_world, run_eval
from testing.worlds.sending import (
    counts_of,
    guess,
    jobs_of,
    outputs_of,
    pair_of,
    parts_left,
    row_of,
    scores_of,
    send,
    taken,
    truth_folder,
    zipped,
)
from tests.plain_confusion import confusion_matrix


@pytest.fixture(scope="module")
def world(standing: World) -> World:
    return standing


def test_a_submission_is_scored_as_the_command_scores_it(world: World, tmp_path: Path) -> None:
    frames = guess(world)
    submission_id = send(world, zipped(world, frames))
    run_eval(world.platform)
    (row,) = scores_of(world.platform, submission_id)
    (tmp_path / "guess.zip").write_bytes(zipped(world, frames))
    told = score(tmp_path / "guess.zip", truth_folder(world, "val", tmp_path)).as_record()
    assert row.signature == told["signature"]
    assert row.record["cells"] == told["cells"]
    assert {name: getattr(row, name) for name in RATIOS} == told["total"]
    confusions, bev = counts_of(world.platform, row)
    everywhere = np.ones((256, 256, 32), np.bool_)
    expected = [confusion_matrix(grid, frames[token], everywhere) for token, grid in world.truth("val").items()]
    assert np.array_equal(confusions.sum(axis=1), expected), "in the order of the manifest"
    assert (confusions.dtype, bev.shape, bev.dtype) == (np.int32, (len(frames), 3, 3), np.int32)
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)


def test_counted_in_parts_it_has_the_same_score(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    content = zipped(world, guess(world, turn=2))
    whole = send(world, content)
    run_eval(world.platform)
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    parted = send(world, content, team=1)
    run_eval(world.platform)
    kinds = [job.kind for job in jobs_of(world.platform, parted)]
    assert kinds == ["eval.open", "eval.part", "eval.part", "eval.join"]
    assert [job.kind for job in jobs_of(world.platform, whole)] == ["eval.open"]
    (one,), (other,) = scores_of(world.platform, whole), scores_of(world.platform, parted)
    assert one.record == other.record
    assert (one.confusions_sha256, one.spectra_sha256) == (other.confusions_sha256, other.spectra_sha256)
    assert one.content_sha256 == other.content_sha256
    assert parts_left(world.platform) == 0


def test_the_file_is_kept_by_its_content_and_the_upload_goes(world: World) -> None:
    content = zipped(world, guess(world, turn=3))
    submission_id = send(world, content)
    before = row_of(world.platform, submission_id)
    assert upload_file(world.platform.settings, before.upload_id or "").exists()
    run_eval(world.platform)
    row = row_of(world.platform, submission_id)
    assert row.blob_sha256 == row.declared_sha256
    with world.platform.database.reading() as session:
        key = session.get_one(Blob, row.blob_sha256).object_key
    assert b"".join(world.platform.store.read(key)) == content
    assert not upload_file(world.platform.settings, row.upload_id or "").exists()


def test_a_validation_is_checked_and_never_scored(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    content = zipped(world, guess(world, turn=4))
    small = send(world, content, kind="validation")
    run_eval(world.platform)
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    parted = send(world, content, kind="validation")
    run_eval(world.platform)
    for submission_id in (small, parted):
        assert row_of(world.platform, submission_id).state == "valid"
        assert scores_of(world.platform, submission_id) == []
        assert taken(world.platform, submission_id) == 0
    assert parts_left(world.platform) == 0


def test_jobs_tell_nothing_but_where_the_submission_stands(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a ratio nor a count of voxels is in a result, a log line or a failure."""
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    submission_id = send(world, zipped(world, guess(world, "test")), "test")
    run_eval(world.platform)
    (row,) = scores_of(world.platform, submission_id)
    assert row.miou is not None
    told = [one for one in outputs_of(world.platform, submission_id) if one is not None]
    assert {name for result, *_ in told if isinstance(result, dict) for name in result} == {"state", "frames"}
    words = json.dumps(told)
    counts = [count for count in np.array(row.record["confusion"]).ravel().tolist() if count > 999]
    assert not [figure for figure in (row.miou, row.iou_occ, *counts) if str(figure)[:6] in words]


def moved_to_store(world: World, submission_id: str) -> None:
    """As if its file had come into the store."""
    platform = world.platform
    with platform.database.transaction() as session:
        upload = session.get_one(Upload, row_of(platform, submission_id).upload_id)
        upload.backend, upload.state = "store", "open"
        upload.expires_ns = 2**62
    path = upload_file(platform.settings, upload.id)
    held = StoreUploadBackend(platform).hold(upload)
    held.append([path.read_bytes()], 0)
    held.accept(is_whole=True)
    held.close()
    remove_file(path)
    with platform.database.transaction() as session:
        session.get_one(Upload, upload.id).state = "consumed"


def slabs(world: World) -> int:
    with world.platform.database.reading() as session:
        return session.scalar(select(func.count()).select_from(UploadPartRow)) or 0


def copies(world: World) -> list[Path]:
    return [path for path in (world.platform.settings.root / "cache/objects/uploads").rglob("*") if path.is_file()]


def test_it_is_scored_and_its_slabs_go(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=31)))
    moved_to_store(world, submission_id)
    assert slabs(world) == 1
    run_eval(world.platform)
    row = row_of(world.platform, submission_id)
    assert (row.state, row.blob_sha256) == ("scored", row.declared_sha256)
    assert (slabs(world), copies(world)) == (0, [])


def test_slabs_that_are_gone_are_told(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=32)))
    moved_to_store(world, submission_id)
    for stored in list(world.platform.store.listed("uploads/")):
        world.platform.store.delete(stored.key)
    run_eval(world.platform)
    row = row_of(world.platform, submission_id)
    assert (row.state, row.failure_code) == ("failed", "upload_damaged")


NOBODY = "0" * 32


def ran(world: World, kind: str, **arguments: object) -> Job:
    """The job after it was run by itself."""
    with world.platform.database.transaction() as session:
        job_id = enqueue(session, JobSpec(kind, arguments), Context(world.administrator.user_id)).id
    run_eval(world.platform)
    with world.platform.database.reading() as session:
        return session.get_one(Job, job_id)


@pytest.mark.parametrize("kind", ["eval.open", "eval.part", "eval.join"])
def test_a_job_of_a_submission_that_is_gone_ends_cancelled(world: World, kind: str) -> None:
    truth_id = pair_of(world, "val").truth_id
    job = ran(world, kind, submission_id=NOBODY, truth_id=truth_id, start=0, stop=1, metric="stone-iou-2")
    assert (job.state, job.attempt) == ("cancelled", 1)


def test_a_job_of_a_ground_truth_that_is_gone_ends_cancelled(world: World) -> None:
    assert ran(world, "eval.truth", truth_id=NOBODY).state == "cancelled"


def test_nothing_is_scored_against_a_ground_truth_that_is_not_ready(world: World) -> None:
    ready = pair_of(world, "val").truth_id
    with world.platform.database.transaction() as session:
        row = session.get_one(GroundTruthRow, ready)
        unready = GroundTruthRow(phase_id=row.phase_id, number=99, dataset_id=row.dataset_id, part="val", mask="all")
        unready.created_by = row.created_by
        session.add(unready)
        session.flush()
        for truth_id in (unready.id, NOBODY):
            with refused_as("ground_truth_unready"):
                truth_of(session, truth_id)
    submission_id = send(world, zipped(world, guess(world, turn=41)))
    run_eval(world.platform)
    ended = ran(world, "eval.join", submission_id=submission_id, truth_id=unready.id, metric="stone-iou-2")
    assert (ended.state, ended.result) == ("succeeded", {"refused": "ground_truth_unready"})
    assert row_of(world.platform, submission_id).state == "scored", "what it has, it keeps"


def test_a_metric_that_nobody_knows_is_refused_and_the_score_stands(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=42)))
    run_eval(world.platform)
    truth_id = pair_of(world, "val").truth_id
    ended = ran(world, "eval.join", submission_id=submission_id, truth_id=truth_id, metric="stone-iou-0")
    assert (ended.state, ended.result) == ("succeeded", {"refused": "unknown_metric"})
    assert [score.metric for score in scores_of(world.platform, submission_id)] == ["stone-iou-2"]


def test_it_is_scored_from_a_bucket(settings: Settings, s3_settings: StoreSettings) -> None:
    platform = opened(settings.model_copy(update={"store": s3_settings}), [])
    world = benchmark_world(platform, frames=1)
    submission_id = send(world, zipped(world, guess(world)))
    run_eval(platform)
    assert (row_of(platform, submission_id).state, taken(platform, submission_id)) == ("scored", 1)
    assert [job.kind for job in jobs_of(platform, submission_id)] == ["eval.open"]
    assert len(scores_of(platform, submission_id)) == 1
    platform.database.close()
