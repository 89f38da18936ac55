"""A range of a submission's frames, looked at in a confined child: only checked, or counted against a ground truth.

**Conventions.** Frames follow `tokens`, the whole manifest; an empty range checks the archive's directory alone. The
child opens both files itself. What it answers is measured before it is believed: a little JSON, then exactly the counts
of the range, little-endian int32 [frame, 3, 4, 4] and [frame, 3, 3].
"""

import json
import struct
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from services.eval.counting import Counted, check_range, count_range
from services.eval.errors import ScoringCrashedError, ScoringInterruptedError, UnreadableInputError
from services.eval.manifest import Manifest
from services.eval.problems import validation_of
from services.eval.scoring_errors import TruthDamagedError
from services.eval.submission_zip import Submission, open_submission
from services.eval.truth_pack import TruthPack, TruthPackError, write_truth_pack
from services.eval.validation import Validation, verdict
from services.runtime.confined import (
    ConfinedCrashedError,
    ConfinedInterruptedError,
    Limits,
    Progress,
    Watch,
    confined_telling,
)
from stone.bitplanes import RINGS, frame_counts, truth_planes
from stone.grid import GRID_SHAPE
from stone.metric import CLASSES

Span = tuple[int, int]
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
    def limits(self) -> Limits:
        frames = self.span[1] - self.span[0]
        cpu_s = 10 + int(FRAME_S * frames)
        return Limits(cpu_s=cpu_s, wall_s=10.0 * cpu_s, answer_bytes=LONGEST_PROBLEMS_BYTES + answer_bytes(frames))


@dataclass(frozen=True, eq=False)
class Counts:
    """Of F frames: `confusions` [F, 3, 4, 4] and `bev` [F, 3, 3], int32."""

    confusions: NDArray[np.int32]
    bev: NDArray[np.int32]

    def packed(self) -> bytes:
        """For a row, until the join."""
        return zlib.compress(self.raw(), 1)

    def raw(self) -> bytes:
        return self.confusions.astype("<i4").tobytes() + self.bev.astype("<i4").tobytes()


@dataclass(frozen=True, eq=False)
class Examined:
    """What is wrong with a range, and, where nothing is and it was to be counted, its counts."""

    validation: Validation
    counts: Counts | None = field(default=None)


def examine(examination: Examination, watch: Watch) -> Examined:
    """Look at the range, in a child.

    Raises `ScoringCrashedError` where the child broke its limits, `ScoringInterruptedError`, and what `watch` raises.
    """
    _warm()
    try:
        answer = confined_telling(partial(_looked_at, examination), examination.limits, watch)
    except ConfinedCrashedError as error:
        raise ScoringCrashedError(error.fate) from error
    except ConfinedInterruptedError as error:
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


def joined(counts: Iterable[Counts]) -> Counts:
    """Ranges one after another."""
    given = list(counts)
    return Counts(*(np.concatenate([getattr(one, name) for one in given]) for name in ("confusions", "bev")))


def answer_bytes(frames: int) -> int:
    """How long the counts of this many frames are."""
    return frames * (CONFUSION_BYTES + BEV_BYTES)


@cache
def _warm() -> None:
    """Load the kernels, or compile them, before the first child: none of them could keep what it does (0.4 s).

    By the way that a frame takes, so that none is forgotten.
    """
    nothing, token = np.zeros(GRID_SHAPE, np.uint8), "0" * 32
    truth = truth_planes(nothing, nothing == 0)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "truth.pack"
        write_truth_pack(path, Manifest({"": (token,)}), lambda _: truth, threads=1)
        with TruthPack(path) as pack:
            frame_counts(nothing, pack.planes_of(token))


def _looked_at(examination: Examination, progress: Progress) -> bytes:
    """The child's part."""
    with open_submission(examination.zip_path, examination.tokens) as submission:
        tokens = examination.tokens[slice(*examination.span)]
        if submission.problems or examination.pack_path is None:
            found = check_range(submission, tokens, threads=1, progress=progress)
            return _answer(verdict([*submission.problems, *found]), b"")
        counted = _counted(submission, tokens, examination.pack_path, progress)
        validation = verdict(counted.problems)
        counts = Counts(counted.confusions, counted.bev)
        return _answer(validation, counts.raw() if validation.ok else b"")


def _counted(submission: Submission, tokens: Sequence[str], pack_path: Path, progress: Progress) -> Counted:
    try:
        with TruthPack(pack_path) as pack:
            return count_range(submission, tokens, pack.planes_of, threads=1, progress=progress)
    except (TruthPackError, UnreadableInputError) as error:
        raise TruthDamagedError from error


def _answer(found: Validation, counts: bytes) -> bytes:
    problems = json.dumps(found.as_record()).encode()
    return HEAD.pack(len(problems)) + problems + counts


def _believed(answer: bytes, examination: Examination) -> Examined:
    stop = HEAD.size + HEAD.unpack_from(answer)[0]
    found = validation_of(json.loads(answer[HEAD.size : stop]))
    frames = examination.span[1] - examination.span[0]
    if not found.ok or examination.pack_path is None:
        return Examined(found)
    return Examined(found, counts_of(answer[stop:], frames))
