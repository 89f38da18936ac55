"""A submission that cannot be scored ends with its reason, costs nothing, and its job has done its work."""

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sqlalchemy import delete, func, select, update

from services.domain.benchmarks.submissions import scoring_ranges
from services.domain.benchmarks.submissions.state_machine import reopen
from services.domain.benchmarks.submissions.submissions import cancel
from services.domain.benchmarks.submissions.sweeper_chores import settle_ended
from services.eval import examination, queue_handlers
from services.eval.queue_handlers import handlers
from services.runtime.jobs.claims import Claim, claim
from services.runtime.jobs.completion import Failure, lose, succeed
from services.runtime.jobs.control import retry
from services.runtime.jobs.execution import run_next
from services.runtime.jobs.specs import Attempt, Outcome
from services.runtime.orm import Alarm, Blob, GroundTruthRow, Job, Score, ScoringEntry, StoreFault, SubmissionRow
from services.runtime.platform import Platform
from services.runtime.store.faults import noted_faults
from services.runtime.uploads import upload_file
from stone.errors import PlatformFaultError, Refused
from testing.worlds.benchmark_world import Grid, World, run_eval
from testing.worlds.decay import flip
from testing.worlds.made import row_of as job_row
from testing.worlds.runs import Said
from testing.worlds.sending import (
    guess,
    jobs_of,
    outputs_of,
    pair_of,
    parts_left,
    row_of,
    scores_of,
    send,
    taken,
    zipped,
)


@pytest.fixture(scope="module")
def world(standing: World) -> World:
    return standing


def ended(world: World, submission_id: str) -> SubmissionRow:
    """The submission after its jobs, which have all succeeded, without a score and without a cost."""
    run_eval(world.platform)
    assert {job.state for job in jobs_of(world.platform, submission_id)} == {"succeeded"}
    assert scores_of(world.platform, submission_id) == []
    assert taken(world.platform, submission_id) == 0
    return row_of(world.platform, submission_id)


def spoilt(frames: Mapping[str, Grid], count: int) -> dict[str, Grid]:
    """The last frames hold a label that is none."""
    last = list(frames)[-count:]
    return {token: np.where(grid == 0, 255, grid).astype(np.uint8) if token in last else grid
            for token, grid in frames.items()}  # fmt: skip


@pytest.mark.parametrize("part_frames", [500, 1])
def test_a_wrong_archive_is_invalid_at_once(world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    frames = guess(world, turn=10)
    missing = next(iter(frames))
    row = ended(world, send(world, zipped(world, {t: grid for t, grid in frames.items() if t != missing})))
    assert row.state == "invalid"
    assert [job.kind for job in jobs_of(world.platform, row.id)] == ["eval.open"]
    (problem,) = (row.problems or {})["errors"]
    assert (problem["code"], problem["frame"]) == ("missing_frame", missing)


@pytest.mark.parametrize("part_frames", [500, 1])
def test_all_frames_that_are_wrong_are_told(world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    frames = spoilt(guess(world, turn=11), 2)
    row = ended(world, send(world, zipped(world, frames)))
    problems: dict[str, Any] = row.problems or {}
    assert (row.state, problems["ok"], problems["errors_total"]) == ("invalid", False, 2)
    assert [one["code"] for one in problems["errors"]] == ["label_out_of_range"] * 2
    assert [one["frame"] for one in problems["errors"]] == list(frames)[-2:]


def test_a_validation_tells_the_same(world: World) -> None:
    row = ended(world, send(world, zipped(world, spoilt(guess(world, turn=12), 1)), kind="validation"))
    assert (row.state, (row.problems or {})["errors_total"]) == ("invalid", 1)


def test_what_is_no_archive_is_told_too(world: World) -> None:
    row = ended(world, send(world, b"PK or so" * 100))
    assert (row.state, (row.problems or {})["errors"][0]["code"]) == ("invalid", "not_zip")


def test_a_file_that_changed_on_the_disk_is_not_taken_for_the_declared_one(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=13)))
    upload_file(world.platform.settings, row_of(world.platform, submission_id).upload_id or "").write_bytes(b"other")
    row = ended(world, submission_id)
    assert (row.state, row.failure_code, row.blob_sha256) == ("failed", "upload_damaged", None)
    assert row.declared_sha256 in row.failure


def test_a_file_that_is_gone_is_told(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=14)))
    upload_file(world.platform.settings, row_of(world.platform, submission_id).upload_id or "").unlink()
    row = ended(world, submission_id)
    assert (row.state, row.failure_code) == ("failed", "upload_damaged")
    assert "has no file" in row.failure


@pytest.mark.parametrize("part_frames", [500, 1])
def test_a_file_that_breaks_its_reader_is_not_read_again(
    world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    monkeypatch.setattr(examination, "count_range", lambda *given, **named: os._exit(3))
    row = ended(world, send(world, zipped(world, guess(world, turn=15))))
    assert (row.state, row.failure_code) == ("failed", "scoring_crashed")
    assert {job.attempt for job in jobs_of(world.platform, row.id)} == {1}


def test_a_child_that_answers_nonsense_is_not_believed(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    """The submission is no score and no verdict, its team reads one sentence, and administrators have an alarm."""
    sent = []
    for turn, nonsense in enumerate((b"", b"\xff", b"\1", b"\0" + bytes(100), b"\0" + bytes(2 * 468))):
        monkeypatch.setattr(examination, "count_submission", lambda *given, said=nonsense: said)
        row = ended(world, send(world, zipped(world, guess(world, turn=16 + turn))))
        assert (row.state, row.failure_code) == ("failed", "scoring_crashed"), nonsense
        sent.append(row)
    assert {row.failure for row in sent} == {sent[0].failure}
    with world.platform.database.reading() as session:
        alarms = select(Alarm.subject).where(Alarm.kind == "impossible_counts")
        assert set(session.scalars(alarms)) >= {row.id for row in sent}


def words(*_: object) -> bytes:
    raise PlatformFaultError("a_code_of_its_own", "voxels of the truth")


def refusal(*_: object) -> bytes:
    raise Refused("a_code_of_its_own", "voxels of the truth")


@pytest.mark.parametrize("say", [words, refusal])
def test_nothing_that_a_counting_child_says_is_kept(
    world: World, say: Callable[..., bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(examination, "count_submission", say)
    row = ended(world, send(world, zipped(world, guess(world, turn=40))))
    assert (row.state, row.failure_code) == ("failed", "scoring_crashed")
    told = json.dumps([row.failure, row.problems, outputs_of(world.platform, row.id)])
    assert "scoring_crashed" in told
    assert not [word for word in ("a_code_of_its_own", "voxels") if word in told]


def test_a_verdict_that_is_none_is_not_believed(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = {"code": "not_zip", "file": "", "frame": None, "expected": "", "actual": ""}
    forged = ({**problem, "code": "of_its_own"}, {**problem, "frame": "0" * 32})
    verdicts = [json.dumps({"errors": [one], "errors_total": 1}).encode() for one in forged]
    for turn, nonsense in enumerate((b"", b"\xff", b"[]", b"[" * 100_000, b'{"errors": []}', *verdicts)):
        monkeypatch.setattr(examination, "check_submission", lambda *given, said=nonsense: said)
        row = ended(world, send(world, zipped(world, guess(world, turn=22 + turn)), kind="validation"))
        assert (row.state, row.failure_code) == ("failed", "scoring_crashed"), nonsense


def test_a_ground_truth_that_decayed_is_the_platforms_fault(world: World) -> None:
    with world.platform.database.reading() as session:
        truth_id = pair_of(world, "val").truth_id
        pack = session.get_one(Blob, session.get_one(GroundTruthRow, truth_id).pack_sha256).object_key
    path = world.platform.store.local(pack)
    sound = path.read_bytes()
    submission_id = send(world, zipped(world, guess(world, turn=20)))
    path.write_bytes(sound[:40] + b"decay" + sound[45:])
    try:
        run_eval(world.platform)
    finally:
        path.write_bytes(sound)
    (job,) = jobs_of(world.platform, submission_id)
    assert (job.state, job.attempt, job.failure_code) == ("failed", 3, "ground_truth_damaged")
    assert "frame" not in job.failure


@pytest.mark.parametrize("place", [0.5, 0.999], ids=["frame", "directory"])
def test_a_submission_that_decays_once_it_is_kept_is_the_platforms_fault(
    world: World, monkeypatch: pytest.MonkeyPatch, place: float
) -> None:
    platform = world.platform
    submission_id = send(world, zipped(world, guess(world, turn=40 + int(10 * place))))
    keep, kept = queue_handlers.keep_file, list[Path]()

    def keep_and_decay(platform: Platform, submission: SubmissionRow) -> None:
        keep(platform, submission)
        with platform.database.reading() as session:
            sha256 = session.get_one(SubmissionRow, submission_id).blob_sha256
            path = platform.store.local(session.get_one(Blob, sha256).object_key)
        if not kept:
            flip(path, place)
            kept.append(path)

    monkeypatch.setattr(queue_handlers, "keep_file", keep_and_decay)
    run_eval(platform)
    settle_ended(platform)
    (job,) = jobs_of(platform, submission_id)
    assert (job.state, job.attempt, job.failure_code) == ("failed", 3, "object_damaged")
    row = row_of(platform, submission_id)
    assert (row.state, row.failure_code, row.problems) == ("failed", "object_damaged", None)
    assert "fault of the platform" in row.failure
    assert taken(platform, submission_id) == 0
    with platform.database.reading() as session:
        assert [one.fault for one in noted_faults(session)] == ["bytes"]
    flip(kept[0], place)
    with platform.database.transaction() as session:
        reopen(session, retry(session, row.job_id or "", 3))
        session.execute(delete(StoreFault))
    run_eval(platform)
    assert (row_of(platform, submission_id).state, taken(platform, submission_id)) == ("scored", 1)


def test_one_that_is_cancelled_while_it_is_counted_keeps_nothing(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", 1)
    submission_id = send(world, zipped(world, guess(world, turn=21)))
    stages = handlers(world.platform)

    def counted_then_cancelled(attempt: Attempt) -> Outcome:
        outcome = stages["eval.part"](attempt)
        with world.platform.database.transaction() as session:
            cancel(session, session.get_one(SubmissionRow, submission_id))
        return outcome

    for stage in (stages["eval.open"], counted_then_cancelled):
        run_next(world.platform, "eval", {**stages, "eval.open": stage, "eval.part": stage})
    assert run_eval(world.platform) == 0
    assert row_of(world.platform, submission_id).state == "cancelled"
    assert [job.state for job in jobs_of(world.platform, submission_id)] == ["succeeded", *["cancelled"] * 3]
    assert (parts_left(world.platform), taken(world.platform, submission_id)) == (0, 0)


def told(platform: Platform) -> tuple[int, int, int]:
    """How many scores, entries of the ledger and parts there are."""
    with platform.database.reading() as session:
        scores, entries = (session.scalar(select(func.count()).select_from(row)) or 0 for row in (Score, ScoringEntry))
    return scores, entries, parts_left(platform)


def deliver_again(platform: Platform, submission_id: str) -> None:
    """Every job of its run stands in the queue as if it had never been done."""
    root_id = row_of(platform, submission_id).job_id
    with platform.database.transaction() as session:
        again = update(Job).where(Job.root_id == root_id, Job.queue != "")
        session.execute(again.values(state="queued", needs_left=0, attempts_left=3))


@pytest.mark.parametrize("part_frames", [500, 1])
def test_jobs_that_are_delivered_again_change_nothing(
    world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    submission_id = send(world, zipped(world, guess(world, turn=part_frames)))
    run_eval(world.platform)
    (score,), before = scores_of(world.platform, submission_id), told(world.platform)
    deliver_again(world.platform, submission_id)
    assert run_eval(world.platform) == len(jobs_of(world.platform, submission_id))
    assert {job.state for job in jobs_of(world.platform, submission_id)} == {"succeeded"}
    assert told(world.platform) == before
    assert [row.id for row in scores_of(world.platform, submission_id)] == [score.id]
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)


@pytest.mark.parametrize("part_frames", [500, 1])
def test_an_attempt_that_was_given_up_writes_nothing_when_it_ends_after_all(
    world: World, part_frames: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each job is worked at twice at once: its first worker falls silent, ends last, and is not heard."""
    monkeypatch.setattr(scoring_ranges, "PART_FRAMES", part_frames)
    submission_id = send(world, zipped(world, guess(world, turn=60 + part_frames)))
    late: list[tuple[Claim, Outcome]] = []
    stages = handlers(world.platform)
    while (first := fallen_silent(world.platform)) is not None:
        late.append((first, stages[first.kind](Said(job_row(world.platform, first.job_id)))))
        assert run_next(world.platform, "eval", stages)
    before = told(world.platform)
    with world.platform.database.transaction() as session:
        assert not any(succeed(session, held, outcome, 3) for held, outcome in late)
    assert len(late) == len(jobs_of(world.platform, submission_id))
    assert {job.attempt for job in jobs_of(world.platform, submission_id)} == {2}
    assert told(world.platform) == before
    assert len(scores_of(world.platform, submission_id)) == 1
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)


def fallen_silent(platform: Platform) -> Claim | None:
    """A job that was claimed, and then given back to the queue because nothing was heard of it."""
    with platform.database.transaction() as session:
        held = claim(session, "eval")
    if held is not None:
        with platform.database.transaction() as session:
            assert lose(session, held, Failure("worker_lost", "no sign of life"))
    return held


def test_a_worker_that_is_lost_too_often_costs_the_team_nothing_and_can_be_tried_again(world: World) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=30)))
    settle_ended(world.platform)  # what other tests left
    while fallen_silent(world.platform) is not None:
        pass
    assert settle_ended(world.platform) == 1
    row = row_of(world.platform, submission_id)
    assert (row.state, row.failure_code, taken(world.platform, submission_id)) == ("failed", "worker_lost", 0)
    with world.platform.database.transaction() as session:
        reopen(session, retry(session, row.job_id or "", 3))
    run_eval(world.platform)
    assert (row_of(world.platform, submission_id).state, taken(world.platform, submission_id)) == ("scored", 1)
    assert len(scores_of(world.platform, submission_id)) == 1


def test_a_fault_of_the_store_is_tried_again(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    submission_id = send(world, zipped(world, guess(world, turn=31)))
    stages, failed = handlers(world.platform), list[str]()

    def at_first_away(attempt: Attempt) -> Outcome:
        if not failed:
            failed.append(attempt.job_id)
            raise OSError(5, "Input/output error")
        return stages["eval.open"](attempt)

    while run_next(world.platform, "eval", {**stages, "eval.open": at_first_away}):
        pass
    assert [job.attempt for job in jobs_of(world.platform, submission_id)] == [2]
    assert row_of(world.platform, submission_id).state == "scored"
