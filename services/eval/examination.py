"""Examination of a range of a submission's frames in a sandboxed process: validation, or counting too.

**Conventions.** Frames follow `tokens`, the whole manifest; an empty range checks the archive's directory alone. The
child opens both files itself. What it answers is measured before it is believed: a little JSON, then exactly the counts
of the range, little-endian int32 [frame, 3, 4, 4] and [frame, 3, 3].
"""

import json
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from services.domain.benchmarks.submissions.scoring_jobs import Span
from services.eval.kernel_warmup import warm
from services.eval.ranges import Counts, ExaminedRange, examined
from services.eval.scoring_errors import TruthDamagedError
from services.eval.truth_pack import TruthPack, TruthPackError
from services.runtime.sandbox import (
    ProgressCallback,
    SandboxCrashedError,
    SandboxInterruptedError,
    SandboxLimits,
    SandboxWatch,
    sandboxed_with_progress,
)
from services.runtime.sandbox.fork_client import warm_unless_served
from stone.scoring.bitplanes import RINGS
from stone.scoring.metric import CLASSES
from stone_submissions.archive import SubmissionZip, open_submission
from stone_submissions.errors import ScoringCrashedError, ScoringInterruptedError, UnreadableInputError
from stone_submissions.verdict import Validation, verdict
from stone_submissions.verdict_record import merged, validation_of

HEAD = struct.Struct("<I")
CONFUSION_SHAPE, BEV_SHAPE = (RINGS, CLASSES, CLASSES), (RINGS, 3)
CONFUSION_BYTES, BEV_BYTES = 4 * RINGS * CLASSES * CLASSES, 4 * RINGS * 3
FRAME_S = 0.1
"""Many times what the slowest honest frame takes (one whose array is stored, not deflated, in a deflated archive)."""
LONGEST_PROBLEMS_BYTES = 2**20


@dataclass(frozen=True)
class Examination:
    """What is to be looked at; without a `pack_path` frames are checked and nothing is counted."""

    zip_path: Path
    tokens: tuple[str, ...]
    span: Span
    pack_path: Path | None = None

    @property
    def limits(self) -> SandboxLimits:
        frames = self.span[1] - self.span[0]
        cpu_s = 10 + int(FRAME_S * frames)
        return SandboxLimits(
            cpu_s=cpu_s,
            wall_s=10.0 * cpu_s,
            answer_bytes=LONGEST_PROBLEMS_BYTES + answer_bytes(frames),
            reads=(self.zip_path, *([self.pack_path] if self.pack_path else [])),
        )


def examine(examination: Examination, watch: SandboxWatch) -> ExaminedRange:
    """Look at the range, in a child.

    Raises `ScoringCrashedError` where the child broke its limits, `ScoringInterruptedError`, and what `watch` raises.
    """
    warm_unless_served(warm)
    try:
        answer = sandboxed_with_progress(partial(count_submission, examination), examination.limits, watch)
    except SandboxCrashedError as error:
        raise ScoringCrashedError(error.fate) from error
    except SandboxInterruptedError as error:
        raise ScoringInterruptedError(error.fate) from error
    try:
        return _believed(answer, examination)
    except (ValueError, TypeError, KeyError, AttributeError, struct.error) as error:
        raise ScoringCrashedError("answered something else than counts") from error


def unpacked(packed: bytes, frames: int) -> Counts:
    """The counts that `Counts.packed` packed, of this many frames."""
    return counts_of(zlib.decompress(packed), frames)


def counts_of(raw: bytes, frames: int) -> Counts:
    """Raises `ValueError` for another number of bytes than that of this many frames."""
    if len(raw) != answer_bytes(frames):
        raise ValueError(f"{len(raw)} bytes are not the counts of {frames} frames")
    confusions = np.frombuffer(raw, "<i4", frames * CONFUSION_BYTES // 4).reshape(frames, *CONFUSION_SHAPE)
    bev = np.frombuffer(raw, "<i4", offset=frames * CONFUSION_BYTES).reshape(frames, *BEV_SHAPE)
    return Counts(confusions.astype(np.int32), bev.astype(np.int32))


def answer_bytes(frames: int) -> int:
    """How long the counts of this many frames are."""
    return frames * (CONFUSION_BYTES + BEV_BYTES)


def count_submission(examination: Examination, progress: ProgressCallback) -> bytes:
    """The child's part."""
    with open_submission(examination.zip_path, examination.tokens) as submission:
        tokens = examination.tokens[slice(*examination.span)]
        if submission.problems or examination.pack_path is None:
            found = examined(submission, tokens, threads=1, progress=progress)
            return _answer(merged([verdict(submission.problems), found.validation]), b"")
        found = _counted(submission, tokens, examination.pack_path, progress)
        return _answer(found.validation, found.counts.raw() if found.counts else b"")


def _counted(
    submission: SubmissionZip, tokens: Sequence[str], pack_path: Path, progress: ProgressCallback
) -> ExaminedRange:
    try:
        with TruthPack(pack_path) as pack:
            return examined(submission, tokens, pack.planes_of, threads=1, progress=progress)
    except (TruthPackError, UnreadableInputError) as error:
        raise TruthDamagedError from error


def _answer(found: Validation, counts: bytes) -> bytes:
    problems = json.dumps(found.as_record()).encode()
    return HEAD.pack(len(problems)) + problems + counts


def _believed(answer: bytes, examination: Examination) -> ExaminedRange:
    stop = HEAD.size + HEAD.unpack_from(answer)[0]
    found = validation_of(json.loads(answer[HEAD.size : stop]))
    frames = examination.span[1] - examination.span[0]
    if not found.ok or examination.pack_path is None:
        return ExaminedRange(found)
    return ExaminedRange(found, counts_of(answer[stop:], frames))
