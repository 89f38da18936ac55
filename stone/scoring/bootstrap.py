"""Confidence intervals of scores, by resampling blocks of frames, or whole sequences.

**Conventions.** Confusions are (…, F, 4, 4) counts by frame, in time order inside each sequence; sequences are
contiguous, their lengths in `frames_of_sequence`. A replicate is a sum (…, replicates, 4, 4) int64 to which any ratio
of `stone.scoring.confusion` applies. Leading axes are submissions: all see the same replicates, so their differences
are paired. The same seed gives the same replicates.

Neighbouring frames see the same ground, so frames are no independent samples (lag-1 correlation 0.9): a bootstrap of
single frames is ten times too narrow. Blocks keep the correlation; whole sequences answer for a new place.

Source: circular block bootstrap, Politis and Romano (1992); percentile intervals, Efron (1979).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from stone.errors import ShapeError
from stone.scoring.confusion import Counts

Sums = NDArray[np.int64]
Interval = tuple[float, float]


@dataclass(frozen=True)
class BootstrapOptions:
    """`block_frames` 200 is 20 s at 10 Hz; `level` is the share of replicates inside the interval."""

    replicates: int = 10_000
    block_frames: int = 200
    level: float = 0.95
    seed: int = 0


DEFAULTS = BootstrapOptions()


@njit(cache=True, nogil=True)
def _add_blocks(prefix: Sums, starts: NDArray[np.int64], lengths: NDArray[np.int64], out: Sums) -> None:
    """Add to each replicate the frames [start, start + length) of its blocks, by two rows of running sums a block."""
    for replicate in range(starts.shape[0]):
        for block in range(starts.shape[1]):
            start = starts[replicate, block]
            stop = start + lengths[block]
            for cell in range(prefix.shape[1]):
                out[replicate, cell] += prefix[stop, cell] - prefix[start, cell]


def block_replicates(
    confusions: Counts, frames_of_sequence: Sequence[int], options: BootstrapOptions = DEFAULTS
) -> Sums:
    """Sums (…, replicates, 4, 4): each sequence rebuilt to its length from circular blocks of its own frames.

    A sequence no longer than a block is always itself. Raises `ShapeError` where lengths and frames disagree.
    """
    cells, batch = _by_frame(confusions, frames_of_sequence)
    random = np.random.default_rng(options.seed)
    sums = np.zeros((options.replicates, cells.shape[1]), np.int64)
    for start, stop in pairwise(np.cumsum([0, *frames_of_sequence]).tolist()):
        lengths = block_lengths(stop - start, options.block_frames)
        starts = block_starts(random, stop - start, len(lengths), options.replicates)
        twice = np.concatenate([cells[start:stop], cells[start:stop]])
        _add_blocks(_running(twice), starts, lengths, sums)
    return _as_confusions(sums, batch)


def sequence_replicates(
    confusions: Counts, frames_of_sequence: Sequence[int], options: BootstrapOptions = DEFAULTS
) -> Sums:
    """Sums (…, replicates, 4, 4) of as many sequences drawn with replacement; every combination where few enough.

    With 5 sequences there are 5^5 = 3,125. Raises `ShapeError` where lengths and frames disagree.
    """
    cells, batch = _by_frame(confusions, frames_of_sequence)
    bounds = np.cumsum([0, *frames_of_sequence])
    of_sequence = np.diff(_running(cells)[bounds], axis=0)
    picks = sequence_picks(len(frames_of_sequence), options)
    times_picked = np.apply_along_axis(np.bincount, 1, picks, minlength=picks.shape[1])
    return _as_confusions(times_picked @ of_sequence, batch)


def interval(values: NDArray[np.floating[Any]], options: BootstrapOptions = DEFAULTS) -> Interval | None:
    """The central percentile interval of a ratio by replicate (replicates,); None where one leaves it undefined."""
    if not np.all(np.isfinite(values)):
        return None
    low, high = np.quantile(values.astype(np.float64), [(1 - options.level) / 2, (1 + options.level) / 2])
    return float(low), float(high)


def block_lengths(frames: int, block_frames: int) -> NDArray[np.int64]:
    """Whole blocks and a shorter last one, together exactly `frames`."""
    whole, rest = divmod(frames, block_frames)
    return np.array([block_frames] * whole + [rest] * (rest > 0), np.int64)


def block_starts(random: np.random.Generator, frames: int, blocks: int, replicates: int) -> NDArray[np.int64]:
    """Where each block of each replicate starts: any frame, the first where one block is the whole sequence."""
    if blocks <= 1:
        return np.zeros((replicates, blocks), np.int64)
    return random.integers(0, frames, (replicates, blocks), np.int64)


def sequence_picks(sequences: int, options: BootstrapOptions) -> NDArray[np.int64]:
    """Which sequences each replicate holds (replicates, sequences)."""
    if sequences**sequences <= options.replicates:
        return np.indices((sequences,) * sequences).reshape(sequences, -1).T.astype(np.int64)
    return np.random.default_rng(options.seed).integers(0, sequences, (options.replicates, sequences), np.int64)


def _by_frame(confusions: Counts, frames_of_sequence: Sequence[int]) -> tuple[Sums, tuple[int, ...]]:
    """Counts (F, batch · 16) int64, and the batch shape."""
    frames = sum(frames_of_sequence)
    if confusions.shape[-3:] != (frames, 4, 4) or frames == 0:
        raise ShapeError("confusions", confusions.shape, f"(…, {frames}, 4, 4) with at least one frame")
    batch = confusions.shape[:-3]
    cells = np.moveaxis(confusions.reshape(-1, frames, 16), 1, 0)
    return np.ascontiguousarray(cells, np.int64).reshape(frames, -1), batch


def _running(cells: Sums) -> Sums:
    return np.concatenate([np.zeros((1, cells.shape[1]), np.int64), np.cumsum(cells, axis=0)])


def _as_confusions(sums: Sums, batch: tuple[int, ...]) -> Sums:
    return np.moveaxis(sums.reshape(len(sums), -1, 16), 0, 1).reshape(*batch, len(sums), 4, 4)
