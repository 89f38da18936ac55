"""Frames of a submission, a thread each block: read, checked, counted; whatever is wrong is collected.

**Conventions.** Counts are in the order of the tokens asked for. A frame that is missing or refused counts zero and has
its problem; nothing stops at the first. `deflate` and the numba kernels release the interpreter, so threads share
cores. Progress is called from the calling thread only. At any time each thread holds one frame.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stone.scoring.bitplanes import RINGS, Confusion, Drivable, LabelRangeError, TruthPlanes, count_by_ring
from stone.scoring.metric import CLASSES
from stone_submissions.archive import SubmissionZip
from stone_submissions.errors import LabelOutOfRangeError
from stone_submissions.validation import THREADS, Progress, frame_grid, in_threads, refusal_of, silent
from stone_submissions.verdict import ValidationProblem

TruthOf = Callable[[str], TruthPlanes]


@dataclass(frozen=True, eq=False)
class CountedFrames:
    """Of F frames: `confusions` [F, ring, truth, prediction] and `bev` [F, ring, 3] int32, and what was refused."""

    confusions: Confusion
    bev: Drivable
    problems: tuple[ValidationProblem, ...]


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


def count_frame(
    submission: SubmissionZip, token: str, truth: TruthPlanes, outs: tuple[Confusion, Drivable]
) -> ValidationProblem | None:
    """Write the confusion (3, 4, 4) and the drivable columns (3, 3) of one frame, or say why it is refused."""

    def count() -> None:
        try:
            count_by_ring(frame_grid(submission, token), truth, *outs)
        except LabelRangeError as error:
            raise LabelOutOfRangeError("labels 0 to 3", str(error.value)) from error

    return refusal_of(submission, token, count)
