"""Results of one submission: what its counts say, by the evaluation version that is asked for."""

import io

import numpy as np
import pytest

from services.domain.benchmarks.submissions.results import (
    BY,
    By,
    breakdown,
    kept_confusions,
    provenance,
    results,
    seen_score,
)
from services.domain.benchmarks.visibility import ANYBODY
from services.runtime.orm import SubmissionRow
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.scoring.confusion import ratios
from stone.scoring.metric import RATIOS
from stone.scoring.silences import SCOPES
from tests.services.domain.benchmarks.boards import ADMINISTRATOR, FRAMES, SEQUENCES, Made, counts, scene


@pytest.mark.parametrize("by", BY)
def test_the_parts_of_a_result_are_ratios_of_their_own_counts(platform: Platform, by: By) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.3))
    with platform.database.reading() as session:
        seen = seen_score(session, ADMINISTRATOR, session.get_one(SubmissionRow, submission_id))
        parts = breakdown(seen, by)
    confusions = counts(Made(0.3))
    starts = {one.name: 450 * place for place, one in enumerate(SEQUENCES)}
    for place, part in enumerate(parts):
        if by == "distance":
            own = confusions[:, place].sum(axis=0, dtype=np.int64)
        else:
            members = [one for one in SEQUENCES if getattr(one, "name" if by == "sequence" else by) == part.name]
            frames = np.concatenate([np.arange(starts[one.name], starts[one.name] + one.frames) for one in members])
            own = confusions[frames].sum(axis=(0, 1), dtype=np.int64)
            assert part.frames == len(frames)
        assert [part.ratios[name] for name in RATIOS] == pytest.approx(ratios(own).tolist())
        assert list(part.support.values()) == own.sum(axis=1).tolist()
    assert len(parts) == {"sequence": 3, "environment": 2, "illumination": 2, "distance": 3}[by]


def test_the_kept_counts_are_those_that_were_made(platform: Platform) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.3))
    with platform.database.reading() as session:
        seen = seen_score(session, ADMINISTRATOR, session.get_one(SubmissionRow, submission_id))
        blob = kept_confusions(session, seen)
    with np.load(io.BytesIO(b"".join(platform.store.read(blob.object_key)))) as arrays:
        assert np.array_equal(arrays["confusions"], counts(Made(0.3)))
        assert arrays["bev"].shape == (FRAMES, 3, 3)


def test_a_result_is_by_the_pair_in_force_and_older_ones_stay_readable(platform: Platform) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.4))
    old = at.score_row(submission_id).id
    new = at.score(submission_id, Made(0.2), at.another_pair(activated_ns=now_ns()))
    with platform.database.reading() as session:
        row = session.get_one(SubmissionRow, submission_id)
        now, before = results(session, ADMINISTRATOR, row), results(session, ADMINISTRATOR, row, old)
    assert (now.seen.score.id, before.seen.score.id) == (new, old)
    assert (now.seen.is_active, before.seen.is_active) == (True, False)
    assert (now.total["miou"] or 0) > (before.total["miou"] or 0)
    assert (now.seen.truth.number, before.seen.truth.number) == (2, 1)


def test_provenance_names_what_a_score_was_made_of_and_by(platform: Platform) -> None:
    at = scene(platform)
    submission_id = at.enter(at.team(), Made(0.4), declared_sha256="d" * 64, size_bytes=77)
    with platform.database.reading() as session:
        seen = seen_score(session, ADMINISTRATOR, session.get_one(SubmissionRow, submission_id))
        found = provenance(seen)
    assert (found.code_version, found.prediction_sha256, found.size_bytes) == ("9.9", "d" * 64, 77)
    assert found.content_sha256 == "c" * 64
    assert seen.truth.sha256 == "7" * 64
    assert seen.score.signature == "metric:a|truth:b"


def test_of_a_score_from_before_silences_were_told_no_interval_is(platform: Platform) -> None:
    at = scene(platform)
    entered = at.enter(at.team(), Made(0.3, is_withdrawn=True))
    with platform.database.reading() as session:
        found = results(session, ANYBODY, session.get_one(SubmissionRow, entered))
    assert found.total["miou"] is not None
    assert found.intervals == dict.fromkeys(SCOPES, dict.fromkeys(RATIOS))
    assert found.silences == dict.fromkeys(SCOPES, dict.fromkeys(RATIOS, "withdrawn"))
