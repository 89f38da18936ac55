"""A submission on disk: a zip of `<frame_token>.npz`, read in place, never extracted.

**Conventions.** Names are the manifest's tokens, optionally all below one common folder; empty entries for such folders
are allowed. Reading uses `pread`, so threads share the descriptor.
"""

import os
import stat
import zipfile
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import deflate
import numpy as np
from numpy.typing import NDArray

from stone_base.counts import counted
from stone_base.label_grid import PAPER, LabelGrid
from stone_files.archives import DEFLATED
from stone_files.atomic import atomic_file
from stone_files.npz import npz_bytes
from stone_submissions.errors import SubmissionError, UnreadableInputError, bad_shape
from stone_submissions.npz_frame import inflate_exactly
from stone_submissions.other_layouts import OF_TOOLS, is_rubbish, other_layout
from stone_submissions.verdict import ValidationProblem, problem_of
from stone_submissions.zip_directory import ZipMember, payload_span, read_directory

SPARE_BYTES = 2**20  # allowance for a frame's file beyond one byte per voxel
SPARE_ENTRIES = 1000
EMPTY_DEFLATED_BYTES = 2


@dataclass(frozen=True)
class SubmissionZip:
    """A submission's frames by token, the problems of the archive itself, and the required grid."""

    name: str
    descriptor: int
    frames: dict[str, ZipMember]
    problems: tuple[ValidationProblem, ...]
    grid: LabelGrid = PAPER

    def read(self, token: str) -> bytes | bytearray:
        """Return the npz file of one frame: a few hundred kB, at most `most_frame_bytes`.

        Raises `truncated`, `corrupt`, `too_large`, `unsupported_zip`, `overlapping_files`.
        """
        member = self.frames[token]
        start, stop = payload_span(self._read_at, member)
        packed = self._read_at(start, stop - start)
        if len(packed) < member.packed_bytes:
            raise SubmissionError("truncated", f"{member.packed_bytes} bytes", f"{len(packed)}")
        npz = inflate_exactly(packed, member.unpacked_bytes) if member.method == DEFLATED else packed
        if deflate.crc32(npz) != member.crc32:
            raise SubmissionError("corrupt", f"CRC-32 {member.crc32:08x}", f"{deflate.crc32(npz):08x}")
        return npz

    def _read_at(self, offset: int, count: int) -> bytes:
        return os.pread(self.descriptor, count, offset)


@contextmanager
def open_submission(path: Path, tokens: Sequence[str], grid: LabelGrid = PAPER) -> Iterator[SubmissionZip]:
    """Open a submission that must contain frames with these tokens and this grid. A broken archive also opens, with one
    problem and no frames.

    Raises `UnreadableInputError` if the file cannot be opened.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)  # a pipe would block
    except OSError as error:
        raise UnreadableInputError(path, error.strerror or "unknown reason") from error
    try:
        yield _matched(path, descriptor, tokens, grid)
    finally:
        os.close(descriptor)


def _matched(path: Path, descriptor: int, tokens: Sequence[str], grid: LabelGrid) -> SubmissionZip:
    try:
        facts = os.fstat(descriptor)
        if not stat.S_ISREG(facts.st_mode):
            raise UnreadableInputError(path, "it is not a file")
        limit = len(tokens) + SPARE_ENTRIES
        members = read_directory(lambda offset, count: os.pread(descriptor, count, offset), facts.st_size, limit)
    except OSError as error:
        raise UnreadableInputError(path, error.strerror or "unknown reason") from error
    except SubmissionError as error:
        return SubmissionZip(path.name, descriptor, {}, (problem_of(error, path.name, None),), grid)
    frames, problems = _matching(members, frozenset(tokens), most_frame_bytes(grid))
    return SubmissionZip(path.name, descriptor, frames, problems, grid)


def most_frame_bytes(grid: LabelGrid) -> int:
    """Return the maximum size of a frame's file."""
    return grid.voxels + SPARE_BYTES


def _matching(
    members: Sequence[ZipMember], tokens: frozenset[str], most_bytes: int
) -> tuple[dict[str, ZipMember], tuple[ValidationProblem, ...]]:
    """Return the valid frames by token, and the problems."""
    prefix = _common_prefix(members, tokens)
    frames: dict[str, ZipMember] = {}
    problems: list[ValidationProblem] = []
    for member in members:
        token = member.name.removeprefix(prefix).removesuffix(".npz")
        if prefix.startswith(member.name) and _is_folder(member):
            continue
        is_ours = f"{prefix}{token}.npz" == member.name and token in tokens
        fault = _fault(member, is_ours, token in frames, most_bytes)
        if fault is not None:
            problems.append(problem_of(fault, member.name, token if is_ours else None))
        if is_ours:
            frames.setdefault(token, member)
    problems += [
        problem_of(
            SubmissionError("missing_frame", f"{prefix}{token}.npz", "no such file"), f"{prefix}{token}.npz", token
        )
        for token in sorted(tokens - frames.keys())
    ]
    problems = _explained(problems, len(frames), {member.name for member in members})
    refused = {problem.frame for problem in problems}
    sound = {token: member for token, member in frames.items() if token not in refused}
    return sound, tuple(problems)


def _explained(problems: list[ValidationProblem], found: int, names: set[str]) -> list[ValidationProblem]:
    """Merge the problems that another layout explains into one, and the problems of a file manager's files into one.

    `found` is the number of valid frames; `names` are the names that problems quote unchanged.
    """
    strangers = [problem.file for problem in problems if problem.code == "unexpected_file"]
    missing = [problem.frame or "" for problem in problems if problem.code == "missing_frame"]
    rubbish = {name for name in strangers if is_rubbish(name)}
    layout = other_layout([name for name in strangers if name not in rubbish and name in names], frozenset(missing))
    what, token_of = layout or ("", {})
    explained = {*token_of.values()}
    merged = []
    if token_of:
        first, count = next(iter(token_of)), f"{len(token_of)} {what}"
        count += f" ({counted(found, 'frame')} named right)" if found else ""
        merged.append(problem_of(SubmissionError("other_layout", "<frame_token>.npz", count), first, None))
    if len(rubbish) > 1:
        first, count = next(name for name in strangers if name in rubbish), f"{len(rubbish)} files: {OF_TOOLS}"
        merged.append(
            problem_of(SubmissionError("unexpected_file", "only the frames of the manifest", count), first, None)
        )
    others = (
        problem
        for problem in problems
        if not (
            problem.code == "unexpected_file"
            and (problem.file in token_of or (len(rubbish) > 1 and problem.file in rubbish))
        )
        and not (problem.code == "missing_frame" and problem.frame in explained)
    )
    return [*merged, *others]


def _fault(member: ZipMember, is_ours: bool, is_second: bool, most_bytes: int) -> SubmissionError | None:
    if not is_ours:
        return SubmissionError("unexpected_file", "only the frames of the manifest", _stranger(member.name))
    if is_second:
        return SubmissionError("duplicate_frame", "each frame once", "a second file with the same name")
    size_bytes = max(member.packed_bytes, member.unpacked_bytes)
    if size_bytes > most_bytes:
        return SubmissionError("too_large", f"at most {most_bytes} bytes per frame", f"{size_bytes} bytes")
    return None


def _stranger(name: str) -> str:
    """Describe a file that is not a frame, if a description helps."""
    return OF_TOOLS if is_rubbish(name) else "another file"


def _common_prefix(members: Sequence[ZipMember], tokens: frozenset[str]) -> str:
    """Return the folder that contains most of the manifest's frames. It is never opened, so any plain path is
    allowed.
    """
    folders = Counter(
        folder + slash
        for folder, slash, file in (member.name.rpartition("/") for member in members)
        if file.removesuffix(".npz") in tokens
    )
    likely = next((folder for folder, _ in folders.most_common(1)), "")
    is_plain = likely.isprintable() and not {"", ".."} & set(likely.split("/")[:-1])
    return likely if is_plain else ""


def _is_folder(member: ZipMember) -> bool:
    return member.name.endswith("/") and member.unpacked_bytes == 0 and member.packed_bytes <= EMPTY_DEFLATED_BYTES


# Writes submissions: a zip of `<frame_token>.npz`, one uint8 grid each.


Grid = NDArray[np.uint8]


def write_files(path: Path, frames: Iterable[tuple[str, bytes]]) -> None:
    """Write frames (token, `frame_file`) as a submission. They are stored, because each is already deflated inside."""
    with atomic_file(path) as staging, zipfile.ZipFile(staging, "w") as archive:
        for token, content in frames:
            archive.writestr(zipfile.ZipInfo(f"{token}.npz"), content)


def frame_file(grid: Grid, label_grid: LabelGrid = PAPER) -> bytes:
    """Return the file of one frame of a label grid. Raises `bad_dtype`, `bad_shape`."""
    if grid.dtype != np.uint8:
        raise SubmissionError("bad_dtype", "uint8 ('|u1')", str(grid.dtype))
    if grid.shape != label_grid.shape:
        raise bad_shape(label_grid, str(grid.shape))
    return npz_bytes({"semantics": grid})
