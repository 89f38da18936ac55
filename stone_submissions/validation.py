"""Whether a submission is complete and well-formed: what the server checks of it, without ground truth.

**Conventions.** A frame that is missing or refused has its problem; nothing stops at the first. `deflate` releases the
interpreter, so threads share cores; at any time each thread holds one frame. Progress is called from the calling
thread only.
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
    """The progress that tells nobody."""


def validate(zip_path: Path, manifest_path: Path, *, threads: int = THREADS, progress: Progress = silent) -> Validation:
    """Everything that is wrong with a submission, short of what only the ground truth knows.

    Raises `UnreadableInputError` for a path that cannot be opened and `bad_manifest` for a broken manifest.
    """
    manifest = read_manifest(manifest_path)
    with open_submission(zip_path, manifest.tokens, manifest.grid) as submission:
        found = verdict(check_range(submission, manifest.tokens, threads=threads, progress=progress))
        return merged([verdict(submission.problems), found])


def check_range(
    submission: SubmissionZip, tokens: Sequence[str], *, threads: int = THREADS, progress: Progress = silent
) -> Iterator[ValidationProblem]:
    """What is wrong with these frames, one after another, short of what only the ground truth knows."""
    here = [token for token in tokens if token in submission.frames]
    found = in_threads(
        lambda index: validate_frame(submission, here[index]), len(here), threads, progress=progress, stage="validate"
    )
    return (problem for problem in found if problem is not None)


def validate_frame(submission: SubmissionZip, token: str) -> ValidationProblem | None:
    """What is wrong with one frame, or None."""

    def look() -> None:
        highest = int(frame_grid(submission, token).max())
        if highest > HIGHEST_LABEL:
            raise SubmissionError("label_out_of_range", "labels 0 to 3", str(highest))

    return refusal_of(submission, token, look)


def frame_grid(submission: SubmissionZip, token: str) -> Grid:
    """The grid of one frame, its values not yet looked at. Raises `SubmissionError`."""
    return prediction_grid(submission.read(token), submission.grid)


def refusal_of(submission: SubmissionZip, token: str, work: Callable[[], None]) -> ValidationProblem | None:
    """What `work` on this frame finds wrong with it, or None."""
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
