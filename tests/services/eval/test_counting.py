"""A range of frames is counted by itself: parts join to the whole, and every problem in it is found."""

from pathlib import Path

import numpy as np
import pytest

from services.eval.counting import count_range
from services.eval.ground_truth import read_truth
from stone.scoring.bitplanes import TruthPlanes
from stone_submissions.archive import open_submission
from stone_submissions.errors import GroundTruthError
from stone_submissions.validation import check_range
from testing.worlds.submission_files import write_submission
from tests.services.eval.conftest import World


def truth_in(world: World, token: str) -> TruthPlanes:
    return read_truth(next(world.folder.glob(f"gts/*/{token}/labels.npz")), "all")


def test_parts_join_to_the_whole(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    tokens = tuple(world.predictions)
    with open_submission(tmp_path / "sub.zip", tokens) as submission:
        whole = count_range(submission, tokens, lambda token: truth_in(world, token))
        parts = [
            count_range(submission, part, lambda t: truth_in(world, t), threads=1) for part in (tokens[:1], tokens[1:])
        ]
    for name in ("confusions", "bev"):
        np.testing.assert_array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name))
    assert whole.confusions.any(axis=(1, 2, 3)).all()
    assert whole.problems == ()


def test_every_problem_of_a_range_is_found_and_its_frames_count_nothing(world: World, tmp_path: Path) -> None:
    tokens = tuple(world.predictions)
    spoiled = [np.where(world.predictions[token] == 3, 200, world.predictions[token]) for token in tokens[:2]]
    write_submission(tmp_path / "sub.zip", zip(tokens[:2], (grid.astype(np.uint8) for grid in spoiled), strict=True))
    with open_submission(tmp_path / "sub.zip", tokens) as submission:
        counted = count_range(submission, tokens, lambda token: truth_in(world, token))
        assert [problem.code for problem in submission.problems] == ["missing_frame"]
        assert tuple(check_range(submission, tokens)) == counted.problems
    assert [(problem.code, problem.frame) for problem in counted.problems] == [
        ("label_out_of_range", token) for token in tokens[:2]
    ]
    assert not counted.confusions.any()
    assert not counted.bev.any()


def test_a_broken_ground_truth_is_no_problem_of_the_submission(world: World, tmp_path: Path) -> None:
    def broken(token: str) -> TruthPlanes:
        raise GroundTruthError(tmp_path / token, "lost")

    write_submission(tmp_path / "sub.zip", world.predictions.items())
    tokens = tuple(world.predictions)
    with open_submission(tmp_path / "sub.zip", tokens) as submission, pytest.raises(GroundTruthError, match="lost"):
        count_range(submission, tokens, broken)


def test_a_range_of_no_frames_is_empty(world: World, tmp_path: Path) -> None:
    write_submission(tmp_path / "sub.zip", world.predictions.items())
    with open_submission(tmp_path / "sub.zip", tuple(world.predictions)) as submission:
        counted = count_range(submission, (), lambda token: truth_in(world, token))
    assert (counted.confusions.shape, counted.bev.shape, counted.problems) == ((0, 3, 4, 4), (0, 3, 3), ())
