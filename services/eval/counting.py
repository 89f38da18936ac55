"""Frames of a submission, a thread each block: read, checked, counted; whatever is wrong is collected.

**Conventions.** `deflate` and the numba kernels release the interpreter, so threads share cores. Progress is called
from the calling thread only. At any time each thread holds one frame.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np

from services.eval.errors import LabelOutOfRangeError, SubmissionError
from services.eval.npz_frame import prediction_grid
from services.eval.submission_zip import Submission
from services.eval.validation import Problem, problem_of
from stone.bitplanes import CLASSES, Confusion, LabelRangeError, TruthPlanes, confusion_by_ring
from stone.grid import Grid

Progress = Callable[[str, int, int], None]
T = TypeVar("T")

BLOCK = 32
HIGHEST_LABEL = CLASSES - 1


def silent(stage: str, done: int, total: int) -> None:
    """The progress that tells nobody."""


def frame_grid(submission: Submission, token: str) -> Grid:
    """The grid of one frame, its values not yet looked at. Raises leaves of `SubmissionError`."""
    return prediction_grid(submission.read(token))


def validate_frame(submission: Submission, token: str) -> Problem | None:
    """What is wrong with one frame, or None."""

    def look() -> None:
        highest = int(frame_grid(submission, token).max())
        if highest > HIGHEST_LABEL:
            raise LabelOutOfRangeError("labels 0 to 3", str(highest))

    return _refusal(submission, token, look)


def count_frame(submission: Submission, token: str, truth: TruthPlanes, out: Confusion) -> Problem | None:
    """Write the confusion (3, 4, 4) of one frame to `out`, or say why it is refused."""

    def count() -> None:
        try:
            out[:] = confusion_by_ring(frame_grid(submission, token), truth)
        except LabelRangeError as error:
            raise LabelOutOfRangeError("labels 0 to 3", str(error.value)) from error

    return _refusal(submission, token, count)


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


def empty_confusions(frames: int) -> Confusion:
    """Zeros [frame, ring, truth, prediction]."""
    return np.zeros((frames, 3, CLASSES, CLASSES), np.int32)


def _refusal(submission: Submission, token: str, work: Callable[[], None]) -> Problem | None:
    try:
        work()
    except SubmissionError as error:
        return problem_of(error, submission.frames[token].name, token)
    return None
