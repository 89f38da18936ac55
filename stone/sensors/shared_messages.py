"""Messages of one topic that two recordings contain, found by content, and the offset of the two clocks.

**Conventions.** A digest covers a message's bytes without its stamp. Only content that occurs once in each recording is
used, because repeated content (a camera's intrinsics) would match at any time. Offsets are added to times of the second
recording to convert them to the first's clock. Zero stamps count as missing.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stone.sensors.clocks import MAD_TO_SIGMA

FEWEST_SHARED = 3
AGREEING_NS, AGREEING_RATIO = 1_000, 0.9
Times = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class TopicMessages:
    """N messages of one topic in one recording, in log-time order: log times, stamps (0: none), digests (N,)."""

    log_times_ns: Times
    stamps_ns: Times
    digests: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.digests)


@dataclass(frozen=True)
class SharedMessages:
    """`stamp_offset_ns` is None if the stamps have no constant offset; `spread_ns` is the log times' scatter (1.4826
    times the median absolute deviation).
    """

    count: int
    stamp_offset_ns: int | None
    log_offset_ns: int
    spread_ns: int


def shared_messages(first: TopicMessages, second: TopicMessages) -> SharedMessages | None:
    """Return the offsets, or None for fewer than `FEWEST_SHARED` messages."""
    rows, others = _once_in_both(first.digests, second.digests)
    if len(rows) < FEWEST_SHARED:
        return None
    logged_ns = first.log_times_ns[rows] - second.log_times_ns[others]
    log_offset_ns = int(np.median(logged_ns))
    spread_ns = round(MAD_TO_SIGMA * float(np.median(np.abs(logged_ns - log_offset_ns))))
    is_stamped = (first.stamps_ns[rows] != 0) & (second.stamps_ns[others] != 0)
    stamped_ns = (first.stamps_ns[rows] - second.stamps_ns[others])[is_stamped]
    return SharedMessages(len(rows), _constant(stamped_ns), log_offset_ns, spread_ns)


def repeated_rows(first: TopicMessages, second: TopicMessages, tolerance_ns: int) -> NDArray[np.int64]:
    """Return the rows of `second` that repeat messages of `first`, with both on one clock.

    They have the same content and the same stamp, or without a stamp, log times within `tolerance_ns`.
    """
    first_keys, second_keys = _keys(first.digests, first.stamps_ns), _keys(second.digests, second.stamps_ns)
    is_same = np.isin(second_keys, first_keys[first.stamps_ns != 0]) & (second.stamps_ns != 0)
    rows, others = (np.flatnonzero(messages.stamps_ns == 0) for messages in (first, second))
    is_same[others] = _is_logged_near(
        (first.digests[rows], first.log_times_ns[rows]),
        (second.digests[others], second.log_times_ns[others]),
        tolerance_ns,
    )
    return np.flatnonzero(is_same)


def runs_of(rows: NDArray[np.int64]) -> tuple[tuple[int, int], ...]:
    """Return ascending rows as half-open runs."""
    if not len(rows):
        return ()
    ends = np.flatnonzero(np.diff(rows) > 1)
    starts = np.concatenate([rows[:1], rows[ends + 1]])
    stops = np.concatenate([rows[ends], rows[-1:]]) + 1
    return tuple(zip(starts.tolist(), stops.tolist(), strict=True))


def _is_logged_near(
    first: tuple[NDArray[np.uint64], Times], second: tuple[NDArray[np.uint64], Times], tolerance_ns: int
) -> NDArray[np.bool_]:
    """Return which messages (K,) of the second were logged within `tolerance_ns` of a message of the first with their
    digest.
    """
    digests, times_ns = (np.concatenate(columns) for columns in zip(first, second, strict=True))
    order = np.lexsort((times_ns, digests))
    digests, times_ns, is_first = digests[order], times_ns[order], order < len(first[0])
    places = np.arange(len(order))
    before = np.maximum.accumulate(np.where(is_first, places, 0))
    after = np.minimum.accumulate(np.where(is_first, places, len(order) - 1)[::-1])[::-1]
    is_near = np.zeros(len(order), np.bool_)
    for other in (before, after):
        is_same = is_first[other] & (digests[other] == digests)
        is_near |= is_same & (np.abs(times_ns[other] - times_ns) <= tolerance_ns)
    is_repeat = np.zeros(len(order), np.bool_)
    is_repeat[order] = is_near
    return is_repeat[len(first[0]) :]


def _once_in_both(first: NDArray[np.uint64], second: NDArray[np.uint64]) -> tuple[NDArray[np.int64], ...]:
    (first_digests, rows), (second_digests, others) = (_once(digests) for digests in (first, second))
    _shared, at, of = np.intersect1d(first_digests, second_digests, assume_unique=True, return_indices=True)
    return rows[at].astype(np.int64), others[of].astype(np.int64)


def _once(digests: NDArray[np.uint64]) -> tuple[NDArray[np.uint64], NDArray[np.intp]]:
    values, rows, counts = np.unique(digests, return_index=True, return_counts=True)
    return values[counts == 1], rows[counts == 1]


def _constant(apart_ns: Times) -> int | None:
    if len(apart_ns) < FEWEST_SHARED:
        return None
    offset_ns = int(np.median(apart_ns))
    agreeing = float((np.abs(apart_ns - offset_ns) <= AGREEING_NS).mean())
    return offset_ns if agreeing >= AGREEING_RATIO else None


def _keys(digests: NDArray[np.uint64], stamps_ns: Times) -> NDArray[np.uint64]:
    """Return one number for content and stamp."""
    with np.errstate(over="ignore"):
        return np.asarray(digests ^ (stamps_ns.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)), np.uint64)
