"""Checks that a submission is complete and well-formed: the server's check, without ground truth.

**Conventions.** Each missing or refused frame has its own problem, and the check continues after a problem. `deflate`
releases the GIL, so threads use several cores; each thread holds one frame at a time. Progress is called only in the
calling thread.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from stone_submissions.archive import SubmissionZip, open_submission
from stone_submissions.errors import SubmissionError
from stone_submissions.manifest import read_manifest
from stone_submissions.npz_frame import prediction_grid
from stone_submissions.verdict import Validation, ValidationProblem, merged, problem_of, verdict

Progress = Callable[[str, int, int], None]
Grid = NDArray[np.uint8]
T = TypeVar("T")

THREADS = 2
BLOCK = 32
HIGHEST_LABEL = 3


def silent(stage: str, done: int, total: int) -> None:
    """Ignore progress."""


def validate(zip_path: Path, manifest_path: Path, *, threads: int = THREADS, progress: Progress = silent) -> Validation:
    """Return all problems of a submission that can be found without ground truth.

    Raises `UnreadableInputError` for a path that cannot be opened and `bad_manifest` for a broken manifest.
    """
    manifest = read_manifest(manifest_path)
    with open_submission(zip_path, manifest.tokens, manifest.grid) as submission:
        problems = verdict(check_range(submission, manifest.tokens, threads=threads, progress=progress))
        return merged([verdict(submission.problems), problems])


def check_range(
    submission: SubmissionZip, tokens: Sequence[str], *, threads: int = THREADS, progress: Progress = silent
) -> Iterator[ValidationProblem]:
    """Yield the problems of these frames in order, as far as they can be found without ground truth."""
    here = [token for token in tokens if token in submission.frames]
    results = in_threads(
        lambda index: validate_frame(submission, here[index]), len(here), threads, progress=progress, stage="validate"
    )
    return (problem for problem in results if problem is not None)


def validate_frame(submission: SubmissionZip, token: str) -> ValidationProblem | None:
    """Return the problem of one frame, or None."""

    def look() -> None:
        highest = int(frame_grid(submission, token).max())
        if highest > HIGHEST_LABEL:
            raise SubmissionError("label_out_of_range", "labels 0 to 3", str(highest))

    return refusal_of(submission, token, look)


def frame_grid(submission: SubmissionZip, token: str) -> Grid:
    """Return the grid of one frame without checking its values. Raises `SubmissionError`."""
    return prediction_grid(submission.read(token), submission.grid)


def refusal_of(submission: SubmissionZip, token: str, work: Callable[[], None]) -> ValidationProblem | None:
    """Return the problem that `work` raises for this frame, or None."""
    try:
        work()
    except SubmissionError as error:
        return problem_of(error, submission.frames[token].name, token)
    return None


def in_threads(
    work: Callable[[int], T], count: int, threads: int, *, progress: Progress = silent, stage: str = ""
) -> Iterator[T]:
    """`work(0)`, `work(1)`, … in order, in blocks on this many threads."""
    starts = range(0, count, BLOCK)

    def block(start: int) -> Sequence[T]:
        return [work(index) for index in range(start, min(start + BLOCK, count))]

    with ThreadPoolExecutor(threads) as pool:
        done = 0
        for results in pool.map(block, starts):
            done += len(results)
            progress(stage, done, count)
            yield from results
