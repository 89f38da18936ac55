"""Examination of a range of a submission's frames in a sandboxed process: validation, or counting too.

**Conventions.** Frames follow `tokens`, the whole manifest; an empty range checks only the archive's directory. The
child opens the files itself. A submission may take over the child that reads it, so a child that also reads the ground
truth returns no text. It returns a `CountingOutcome` in one byte, then exactly the counts of the range, little-endian
int32 in the order of `ARRAYS`. The parent checks these counts against the supports of the ground truth. If the child
counted nothing, a child without the ground truth returns the errors as JSON.
"""

import json
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import partial
from math import prod
from pathlib import Path

import numpy as np
import structlog
from numpy.typing import NDArray

from services.domain.benchmarks.submissions.scoring_ranges import Span
from services.eval.kernel_warmup import warm
from services.eval.truth_pack import TruthPack, TruthPackError
from services.eval.truth_supports import can_be_counted, supports_of, truth_damaged
from services.runtime.sandbox import (
    ProgressCallback,
    SandboxCrashedError,
    SandboxInterruptedError,
    SandboxLimits,
    SandboxWatch,
    sandboxed_with_progress,
)
from services.runtime.sandbox.fork_client import warm_unless_served
from stone.errors import PlatformFaultError, Refused
from stone.scoring.bitplanes import NO_COLUMN_COUNTS, count_by_ring, late_confusion
from stone.scoring.frame_counts import (
    ColumnCounts,
    Confusion,
    Drivable,
    LabelRangeError,
    TruthPlanes,
    counted_every,
    no_column_counts,
)
from stone.scoring.metric import CLASSES
from stone.scoring.plane_layout import RINGS
from stone_base.label_grid import PAPER, LabelGrid
from stone_submissions.archive import SubmissionZip, open_submission
from stone_submissions.errors import MISTAKES, SubmissionError, UnreadableInputError
from stone_submissions.validation import (
    BLOCK,
    THREADS,
    Progress,
    check_range,
    frame_grid,
    in_threads,
    refusal_of,
    silent,
)
from stone_submissions.verdict import Validation, ValidationProblem, merged, validation_of, verdict

# Frames of a submission, one thread per block: read, checked, counted, with all faults collected. Counts are in the
# order of the given tokens. A missing or refused frame counts zero and has its problem; the other frames are still
# read. `deflate` and the numba kernels release the interpreter, so threads share cores. Only the calling thread calls
# the progress callback. Each thread holds one frame at a time.


TruthOf = Callable[[str], TruthPlanes]


@dataclass(frozen=True, eq=False)
class CountedFrames:
    """The counts and refusals of F frames.

    - `confusions` [F, ring, truth, prediction], `bev` [F, ring, 3] int32
    - the counts by column
    - `late` [F, truth, prediction]: the counts of late voxels
    """

    confusions: Confusion
    bev: Drivable
    column_counts: ColumnCounts
    late: Confusion
    problems: tuple[ValidationProblem, ...]


def sampled_tokens(tokens: Sequence[str]) -> frozenset[str]:
    """Return the frames of a manifest's tokens for which columns are counted."""
    return frozenset(tokens[:: counted_every(len(tokens))])


def count_range(
    submission: SubmissionZip,
    tokens: Sequence[str],
    truth_of: TruthOf,
    *,
    sampled: Set[str] = frozenset(),
    threads: int = THREADS,
    progress: Progress = silent,
) -> CountedFrames:
    """Return the counts of these frames with all checks; column and late counts are zero outside `sampled`.

    Faults of the archive as a whole are not repeated. Raises what `truth_of` raises.
    """
    shape = (len(tokens),)
    confusions, bev = np.zeros((*shape, RINGS, CLASSES, CLASSES), np.int32), np.zeros((*shape, RINGS, 3), np.int32)
    late = np.zeros((*shape, CLASSES, CLASSES), np.int32)
    counted = CountedFrames(confusions, bev, no_column_counts(shape), late, ())

    def one(index: int) -> ValidationProblem | None:
        token = tokens[index]
        if token not in submission.frames:
            return None
        outs, is_sampled = (confusions[index], bev[index]), token in sampled
        within = counted.column_counts.of_frame(index)
        problem = count_frame(
            *(submission, token, truth_of(token), (*outs, within if is_sampled else NO_COLUMN_COUNTS)),
            late[index] if is_sampled else None,
        )
        if problem is not None:
            for counts in (*outs, within.pairs, within.columns, late[index]):
                counts[...] = 0
        return problem

    problems = in_threads(one, len(tokens), threads, progress=progress, stage="score")
    return replace(counted, problems=tuple(problem for problem in problems if problem is not None))


def count_frame(
    submission: SubmissionZip,
    token: str,
    truth: TruthPlanes,
    outs: tuple[Confusion, Drivable, ColumnCounts],
    late_out: Confusion | None = None,
) -> ValidationProblem | None:
    """Write the counts of one frame as `count_by_ring` does, and its late counts; return the problem, if any."""

    def count() -> None:
        try:
            grid = frame_grid(submission, token)
            count_by_ring(grid, truth, *outs)
            if late_out is not None:
                late_out[...] = late_confusion(grid, truth)
        except LabelRangeError as error:
            raise SubmissionError("label_out_of_range", "labels 0 to 3", str(error.value)) from error

    return refusal_of(submission, token, count)


# Examined ranges of a submission's frames and their join: the basis of every score. Faults of the archive as a whole
# are found at its opening and not repeated by a range.


@dataclass(frozen=True, eq=False)
class Counts:
    """The counts of F frames; `column_counts` and `late` are None if not stored.

    `confusions` [F, 3, 4, 4], `bev` [F, 3, 3] int32, and `late` [F, 4, 4] of late voxels.
    """

    confusions: NDArray[np.int32]
    bev: NDArray[np.int32]
    column_counts: ColumnCounts | None = None
    late: NDArray[np.int32] | None = None

    def arrays(self) -> dict[str, NDArray[np.int32]]:
        """Return all counts by their stored names."""
        column_counts = vars(self.column_counts) if self.column_counts else {}
        late = {"late": self.late} if self.late is not None else {}
        return {"confusions": self.confusions, "bev": self.bev, **column_counts, **late}

    def packed(self) -> bytes:
        """Return the compressed counts for a row, until the join."""
        return zlib.compress(self.raw(), 1)

    def raw(self) -> bytes:
        return b"".join(array.astype("<i4").tobytes() for array in self.arrays().values())


@dataclass(frozen=True, eq=False)
class ExaminedRange:
    """The faults of a range, or its counts if it has none and is to be counted."""

    validation: Validation
    counts: Counts | None = field(default=None)


def examined(
    submission: SubmissionZip,
    tokens: Sequence[str],
    truth_of: TruthOf | None = None,
    *,
    sampled: Set[str] = frozenset(),
    threads: int = THREADS,
    progress: Progress = silent,
) -> ExaminedRange:
    """Return these frames of a submission, counted against their ground truth or, without it, only checked.

    Raises what `truth_of` raises.
    """
    if truth_of is None:
        return ExaminedRange(verdict(check_range(submission, tokens, threads=threads, progress=progress)))
    counted = count_range(submission, tokens, truth_of, sampled=sampled, threads=threads, progress=progress)
    validation = verdict(counted.problems)
    counts = Counts(counted.confusions, counted.bev, counted.column_counts, counted.late)
    return ExaminedRange(validation, counts if validation.ok else None)


def joined(ranges: Iterable[ExaminedRange]) -> ExaminedRange:
    """Join consecutive ranges; the result has counts if each range has."""
    given = list(ranges)
    counts = [part.counts for part in given if part.counts is not None]
    validation = merged(part.validation for part in given)
    return ExaminedRange(validation, _concatenate(counts) if counts and len(counts) == len(given) else None)


def _concatenate(counts: Sequence[Counts]) -> Counts:
    arrays = [part.arrays() for part in counts]
    return counts_in({name: np.concatenate([part[name] for part in arrays]) for name in arrays[0]})


def counts_in(arrays: Mapping[str, NDArray[np.int32]]) -> Counts:
    """Return the counts with these `Counts.arrays`. Raises KeyError if an array is missing."""
    column_counts = ColumnCounts(arrays["pairs"], arrays["columns"]) if "pairs" in arrays else None
    return Counts(arrays["confusions"], arrays["bev"], column_counts, arrays.get("late"))


ARRAYS: Mapping[str, tuple[int, ...]] = {
    "confusions": (RINGS, CLASSES, CLASSES),
    "bev": (RINGS, 3),
    "pairs": (RINGS, CLASSES),
    "columns": (RINGS, CLASSES, CLASSES),
    "late": (CLASSES, CLASSES),
}
FRAME_BYTES = 4 * sum(map(prod, ARRAYS.values()))
FRAME_S = 0.1
"""Many times the slowest honest frame (an array stored, not deflated, in a deflated archive)."""
LONGEST_PROBLEMS_BYTES = 2**20

log = structlog.get_logger(__name__)


class CountingOutcome(IntEnum):
    """The only values that a child reading a ground truth may return besides counts."""

    COUNTED = 0
    NOT_COUNTED = 1
    TRUTH_DAMAGED = 2


class ImpossibleCountsError(Refused):
    """Counting a valid file ended in an impossible way; `fault` is for the operator's log."""

    def __init__(self, fault: str) -> None:
        log.warning("counting ended in an impossible way", fault=fault)
        super().__init__(
            "scoring_crashed", "counting the submission was interrupted; was it written by numpy.savez_compressed?"
        )


@dataclass(frozen=True)
class Examination:
    """The frames of a grid to examine; without a `pack_path` they are checked but not counted."""

    zip_path: Path
    tokens: tuple[str, ...]
    span: Span
    pack_path: Path | None = None
    grid: LabelGrid = PAPER

    @property
    def frames(self) -> int:
        return self.span[1] - self.span[0]

    @property
    def limits(self) -> SandboxLimits:
        cpu_s = 10 + int(FRAME_S * self.frames)
        words = SandboxLimits(cpu_s=cpu_s, wall_s=10.0 * cpu_s, reads=(self.zip_path,))
        if self.pack_path is None:
            return replace(words, answer_bytes=LONGEST_PROBLEMS_BYTES)
        reads = (self.zip_path, self.pack_path)
        return replace(words, reads=reads, answer_bytes=1 + answer_bytes(self.frames), may_quote=False)


def examine(examination: Examination, watch: SandboxWatch) -> ExaminedRange:
    """Examine the range in a child.

    Raises `scoring_crashed` if the child broke its limits, `ImpossibleCountsError`, `scoring_interrupted`,
    `ground_truth_damaged`, and what `watch` raises.
    """
    warm_unless_served(warm)
    unseeing = replace(examination, pack_path=None)
    if examination.pack_path is None or not examination.frames:
        return _check_in_child(unseeing, watch)
    supports = supports_of(examination.pack_path, len(examination.tokens))[slice(*examination.span)]
    counts = _counted_apart(examination, watch)
    if counts is None:
        checked = _check_in_child(unseeing, watch)
        if checked.validation.ok:
            raise ImpossibleCountsError("counted nothing although the frames are valid")
        return checked
    if not can_be_counted(counts.arrays(), supports, _is_sampled(examination)):
        raise ImpossibleCountsError("returned counts that no prediction can have against this ground truth")
    return ExaminedRange(verdict(()), counts)


def _counted_apart(examination: Examination, watch: SandboxWatch) -> Counts | None:
    """Return the counts from a child that reads the ground truth and returns nothing else; None if it counted nothing.

    Raises `scoring_interrupted`, `ground_truth_damaged`, and what `watch` raises.
    """
    silent_watch = SandboxWatch(watch.on_poll, partial(_pass_on, watch, examination.frames))
    try:
        answer = sandboxed_with_progress(partial(count_submission, examination), examination.limits, silent_watch)
    except SandboxCrashedError as error:
        log.warning("a counting child crashed", fate=error.fate)
        return None
    except SandboxInterruptedError as error:
        log.warning("a counting child was interrupted", fate=error.fate)
        raise _interrupted("was interrupted") from error
    outcome, raw = answer[:1], answer[1:]
    if outcome == bytes([CountingOutcome.TRUTH_DAMAGED]):
        raise truth_damaged()
    is_counted = outcome == bytes([CountingOutcome.COUNTED]) and len(raw) == answer_bytes(examination.frames)
    return counts_of(raw, examination.frames) if is_counted else None


def _pass_on(watch: SandboxWatch, frames: int, _stage: str, ticks: int, _total: int) -> None:
    """Forward progress as the number of blocks that the child reported."""
    watch.progress("score", min(ticks * BLOCK, frames), frames)


def _is_sampled(examination: Examination) -> NDArray[np.bool_]:
    wanted = sampled_tokens(examination.tokens)
    return np.array([token in wanted for token in examination.tokens[slice(*examination.span)]])


def _check_in_child(examination: Examination, watch: SandboxWatch) -> ExaminedRange:
    """Return the range as checked by a child that reads no ground truth. Raises as `examine`."""
    try:
        answer = sandboxed_with_progress(partial(check_submission, examination), examination.limits, watch)
        validation = validation_of(json.loads(answer))
    except SandboxCrashedError as error:
        raise scoring_crashed(error.fate) from error
    except SandboxInterruptedError as error:
        raise _interrupted(error.fate) from error
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise scoring_crashed("returned something other than a validation") from error
    frames = (None, *examination.tokens)
    if any(problem.code not in MISTAKES or problem.frame not in frames for problem in validation.errors):
        raise scoring_crashed("returned something other than a validation")
    return ExaminedRange(validation)


def unpacked(packed: bytes, frames: int) -> Counts:
    """Return the counts of this number of frames from `Counts.packed`."""
    return counts_of(zlib.decompress(packed), frames)


def counts_of(raw: bytes, frames: int) -> Counts:
    """Return the counts. Raises `ValueError` if the number of bytes does not fit this number of frames."""
    if len(raw) != answer_bytes(frames):
        raise ValueError(f"{len(raw)} bytes are not the counts of {frames} frames")
    arrays, start = dict[str, NDArray[np.int32]](), 0
    for name, shape in ARRAYS.items():
        numbers = np.frombuffer(raw, "<i4", frames * prod(shape), start)
        arrays[name], start = numbers.reshape(frames, *shape).astype(np.int32), start + numbers.nbytes
    return counts_in(arrays)


def answer_bytes(frames: int) -> int:
    """Return the bytes of the counts of this number of frames."""
    return frames * FRAME_BYTES


def check_submission(examination: Examination, progress: ProgressCallback) -> bytes:
    """Return the validation of the range, as JSON; runs in the child that reads no ground truth."""
    with open_submission(examination.zip_path, examination.tokens, examination.grid) as submission:
        tokens = examination.tokens[slice(*examination.span)]
        checked = examined(submission, tokens, threads=1, progress=progress)
        return json.dumps(merged([verdict(submission.problems), checked.validation]).as_record()).encode()


def count_submission(examination: Examination, progress: ProgressCallback) -> bytes:
    """Return an outcome and the counts of the range, if any; runs in the child that reads the ground truth."""
    if examination.pack_path is None:
        return bytes([CountingOutcome.NOT_COUNTED])
    with open_submission(examination.zip_path, examination.tokens, examination.grid) as submission:
        if submission.problems:
            return bytes([CountingOutcome.NOT_COUNTED])
        tokens, sampled = examination.tokens[slice(*examination.span)], sampled_tokens(examination.tokens)
        try:
            with TruthPack(examination.pack_path) as pack:
                counted = examined(submission, tokens, pack.planes_of, sampled=sampled, threads=1, progress=progress)
        except (TruthPackError, UnreadableInputError):
            return bytes([CountingOutcome.TRUTH_DAMAGED])
        return (
            bytes([CountingOutcome.COUNTED]) + counted.counts.raw()
            if counted.counts
            else bytes([CountingOutcome.NOT_COUNTED])
        )


def scoring_crashed(fate: str) -> Refused:
    return Refused(
        "scoring_crashed", f"the process that read the submission {fate}; was it written by numpy.savez_compressed?"
    )


def _interrupted(fate: str) -> PlatformFaultError:
    return PlatformFaultError("scoring_interrupted", f"the process that read the submission {fate}; the job is retried")
