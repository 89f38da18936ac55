"""Frames of a submission, a thread each block: read, checked, counted; whatever is wrong is collected.

**Conventions.** Counts are in the order of the tokens asked for. A frame that is missing or refused counts zero and has
its problem; nothing stops at the first. `deflate` and the numba kernels release the interpreter, so threads share
cores. Progress is called from the calling thread only. At any time each thread holds one frame.
"""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from stone.labels.grid import Grid
from stone.scoring.bitplanes import RINGS, Confusion, Drivable, LabelRangeError, TruthPlanes, count_by_ring
from stone.scoring.metric import CLASSES
from stone_submissions.archive import SubmissionZip
from stone_submissions.errors import LabelOutOfRangeError, SubmissionError
from stone_submissions.npz_frame import prediction_grid
from stone_submissions.verdict import ValidationProblem, problem_of

Progress = Callable[[str, int, int], None]
TruthOf = Callable[[str], TruthPlanes]
T = TypeVar("T")

THREADS = 2
BLOCK = 32
HIGHEST_LABEL = CLASSES - 1


@dataclass(frozen=True, eq=False)
class CountedFrames:
    """Of F frames: `confusions` [F, ring, truth, prediction] and `bev` [F, ring, 3] int32, and what was refused."""

    confusions: Confusion
    bev: Drivable
    problems: tuple[ValidationProblem, ...]


def silent(stage: str, done: int, total: int) -> None:
    """The progress that tells nobody."""


def frame_grid(submission: SubmissionZip, token: str) -> Grid:
    """The grid of one frame, its values not yet looked at. Raises leaves of `SubmissionError`."""
    return prediction_grid(submission.read(token))


def count_range(
    submission: SubmissionZip,
    tokens: Sequence[str],
    truth_of: TruthOf,
    *,
    threads: int = THREADS,
    progress: Progress = silent,
) -> CountedFrames:
    """The counts of these frames, every check on. What is wrong with the archive as a whole is not told again.

    Raises what `truth_of` raises.
    """
    counted = CountedFrames(
        np.zeros((len(tokens), RINGS, CLASSES, CLASSES), np.int32), np.zeros((len(tokens), RINGS, 3), np.int32), ()
    )

    def one(index: int) -> ValidationProblem | None:
        if tokens[index] not in submission.frames:
            return None
        truth = truth_of(tokens[index])
        problem = count_frame(submission, tokens[index], truth, (counted.confusions[index], counted.bev[index]))
        if problem is not None:
            counted.confusions[index], counted.bev[index] = 0, 0
        return problem

    found = in_threads(one, len(tokens), threads, progress=progress, stage="score")
    return replace(counted, problems=tuple(problem for problem in found if problem is not None))


def check_range(
    submission: SubmissionZip, tokens: Sequence[str], *, threads: int = THREADS, progress: Progress = silent
) -> tuple[ValidationProblem, ...]:
    """What is wrong with these frames, short of what only the ground truth knows."""
    here = [token for token in tokens if token in submission.frames]
    found = in_threads(
        lambda index: validate_frame(submission, here[index]), len(here), threads, progress=progress, stage="validate"
    )
    return tuple(problem for problem in found if problem is not None)


def validate_frame(submission: SubmissionZip, token: str) -> ValidationProblem | None:
    """What is wrong with one frame, or None."""

    def look() -> None:
        highest = int(frame_grid(submission, token).max())
        if highest > HIGHEST_LABEL:
            raise LabelOutOfRangeError("labels 0 to 3", str(highest))

    return _refusal(submission, token, look)


def count_frame(
    submission: SubmissionZip, token: str, truth: TruthPlanes, outs: tuple[Confusion, Drivable]
) -> ValidationProblem | None:
    """Write the confusion (3, 4, 4) and the drivable columns (3, 3) of one frame, or say why it is refused."""

    def count() -> None:
        try:
            count_by_ring(frame_grid(submission, token), truth, *outs)
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


def _refusal(submission: SubmissionZip, token: str, work: Callable[[], None]) -> ValidationProblem | None:
    try:
        work()
    except SubmissionError as error:
        return problem_of(error, submission.frames[token].name, token)
    return None
