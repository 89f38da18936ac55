"""The record of a score: every table is computed from the stored counts by frame and ring.

**Conventions.** Frames have the order of the ground truth's manifest; sequences are contiguous runs of them. Intervals
treat drives as independent: sequences that continue each other count as one, joined in time. Ratios are in [0, 1] or
None if undefined. The record is complete; the caller restricts who may see which part.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import accumulate, pairwise
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from stone.scoring.confusion import Counts, extras, named_ratios, supports, tolerant_ratios
from stone.scoring.frame_counts import ColumnCounts, Confusion, Drivable, counted_every
from stone.scoring.intervals import (
    SCOPES,
    UNKNOWN_ORDER,
    WITHDRAWN,
    Estimate,
    RatioSpectra,
    Silence,
    estimates,
    ratio_spectra,
)
from stone.scoring.metric import METRIC_VERSION, OCCUPIED_VERSION, RATIOS, Metric, metric_of
from stone.scoring.plane_layout import RING_EDGES_M
from stone.scoring.signature import Signature

Record = dict[str, Any]
RING_NAMES = tuple(
    f"{low:g}-{high:g}m" if high else f"from-{low:g}m"
    for low, high in zip((0.0, *RING_EDGES_M), (*RING_EDGES_M, None), strict=True)
)


@dataclass(frozen=True)
class SequenceFacts:
    """Facts about a sequence, None if unknown. `drive` is the drive that it shares with other sequences; `places` are
    its frames' positions in time, () if the frames are in time order.
    """

    name: str
    frames: int
    environment: str | None = None
    illumination: str | None = None
    drive: str | None = None
    first_stamp_ns: int | None = None
    places: tuple[int, ...] = ()

    def in_time(self) -> NDArray[np.intp]:
        """Return the indices of the frames in time order."""
        return np.argsort(self.places) if self.places else np.arange(self.frames)


class Timed(Protocol):
    """A sequence with a known time order of its frames."""

    @property
    def first_stamp_ns(self) -> int: ...
    @property
    def drive(self) -> str | None: ...


def facts_of(
    sequences: Mapping[str, Sequence[str]], timed: Mapping[str, Timed] | None = None
) -> tuple[SequenceFacts, ...]:
    """Return the facts about sequences with these frame tokens, in time order if they are `timed`."""
    if timed is None:
        return tuple(SequenceFacts(name, len(tokens)) for name, tokens in sequences.items())
    return tuple(
        SequenceFacts(name, len(tokens), drive=timed[name].drive, first_stamp_ns=timed[name].first_stamp_ns)
        for name, tokens in sequences.items()
    )


@dataclass(frozen=True, eq=False)
class SubmissionCounts:
    """All counts of one submission: `confusions` [F, 3, 4, 4] and `bev` [F, 3, 3] int32, for the frames of `sequences`.

    `column_counts` and the counts of `late` voxels [F, 4, 4] are zero for frames without them, and None if an earlier
    version counted.
    """

    confusions: Confusion
    bev: Drivable
    sequences: tuple[SequenceFacts, ...]
    column_counts: ColumnCounts | None = None
    late: NDArray[np.int32] | None = None

    @property
    def frames_of_sequence(self) -> tuple[int, ...]:
        return tuple(sequence.frames for sequence in self.sequences)

    def spectra(self, metric: str = METRIC_VERSION) -> RatioSpectra:
        """Return the spectra for the uncertainty of the ratios. Raises `unknown_metric`, and `ShapeError`."""
        runs = list(pairwise(accumulate(self.frames_of_sequence, initial=0)))
        drives = self._drives()
        order = np.concatenate([runs[row][0] + self.sequences[row].in_time() for rows in drives for row in rows])
        frames_of_drive = tuple(sum(self.sequences[row].frames for row in rows) for rows in drives)
        return spectra_of(self.confusions[order], frames_of_drive, metric_of(metric))

    def _drives(self) -> list[list[int]]:
        """Return the indices of the sequences of each drive, in time order."""
        drives = dict[tuple[bool, str], list[int]]()
        for row, facts in enumerate(self.sequences):
            drives.setdefault((bool(facts.drive), facts.drive or facts.name), []).append(row)
        return [sorted(rows, key=lambda row: self.sequences[row].first_stamp_ns or 0) for rows in drives.values()]

    def columns(self) -> NDArray[np.int64] | None:
        """Return the confusion matrix (4, 4) of the columns of all frames."""
        return self.column_counts.columns.sum(axis=(0, 1), dtype=np.int64) if self.column_counts else None

    def cells(self) -> NDArray[np.int64]:
        """Return the confusion matrices of each sequence [sequence, ring, truth, prediction]."""
        runs = pairwise(accumulate(self.frames_of_sequence, initial=0))
        return np.stack([self.confusions[start:stop].sum(axis=0, dtype=np.int64) for start, stop in runs])


@dataclass(frozen=True)
class ConfidenceLimit:
    """The minimum confidence of evaluated occupied voxels, and the number of occupied voxels `left_out` below it."""

    least_confidence: float
    left_out: int

    def as_record(self, occupied: int) -> Record:
        """Return the record with the share of excluded occupied voxels; `occupied` counts the evaluated ones."""
        whole = self.left_out + occupied
        return {**asdict(self), "left_out_ratio": self.left_out / whole if whole else None}


@dataclass(frozen=True, eq=False)
class Scores:
    """The scores of one submission against one ground truth; whether its frames are in time order, which intervals
    require; and the code version that counted it.
    """

    counts_of_frames: SubmissionCounts
    signature: Signature
    is_in_time_order: bool
    code_version: str
    limit: ConfidenceLimit | None = None

    def as_record(self) -> Record:
        """Return the output of `stone score --json`."""
        counts_of_frames, metric = self.counts_of_frames, self.signature.metric
        spectra = counts_of_frames.spectra(metric)
        record = record_of(counts_of_frames, spectra, metric, is_in_time_order=self.is_in_time_order)
        occupied = sum(map(sum, record["confusion"][1:]))
        return {
            **record,
            **({"confidence": self.limit.as_record(occupied)} if self.limit else {}),
            "signature": str(self.signature),
            "code_version": self.code_version,
        }


def record_of(
    counts_of_frames: SubmissionCounts,
    spectra: RatioSpectra,
    metric: str = METRIC_VERSION,
    *,
    is_in_time_order: bool = True,
) -> Record:
    """Return the complete record of a score; `spectra` must belong to the same counts and metric.

    Raises `unknown_metric`.
    """
    cells = counts_of_frames.cells()
    total = cells.sum(axis=(0, 1))
    ratios = named_ratios(total, metric)
    return {
        "frames": len(counts_of_frames.confusions),
        "total": ratios,
        "within_occupied": named_ratios(total, OCCUPIED_VERSION),
        **_column_record(counts_of_frames),
        "late": _late_record(counts_of_frames, metric),
        "support": supports(total),
        "confusion": total.tolist(),
        "extras": asdict(
            extras(total, counts_of_frames.bev.sum(axis=(0, 1), dtype=np.int64), counts_of_frames.columns())
        ),
        **interval_record(ratios, spectra, metric_of(metric), is_in_time_order=is_in_time_order),
        "by": dict(_breakdowns(counts_of_frames, cells, metric)),
        "cells": {s.name: cell.tolist() for s, cell in zip(counts_of_frames.sequences, cells, strict=True)},
    }


def _column_record(counts_of_frames: SubmissionCounts) -> Record:
    """Return `tolerant` and `columns`: the ratios by name of the frames in which they are counted, or None."""
    columns, column_counts = counts_of_frames.columns(), counts_of_frames.column_counts
    if columns is None or column_counts is None:
        return {"tolerant": None, "columns": None}
    counted = counts_of_frames.confusions[:: counted_every(len(counts_of_frames.confusions))]
    pairs = column_counts.pairs.sum(axis=(0, 1), dtype=np.int64)
    return {
        "tolerant": tolerant_ratios(counted.sum(axis=(0, 1), dtype=np.int64), pairs),
        "columns": named_ratios(columns),
    }


def _late_record(counts_of_frames: SubmissionCounts, metric: str) -> Record | None:
    """Return the ratios of late voxels and of all others, over frames that count both; None without late voxels."""
    if counts_of_frames.late is None or not counts_of_frames.late.any():
        return None
    is_counted = counts_of_frames.late.any(axis=(1, 2))
    whole = counts_of_frames.confusions[is_counted].sum(axis=(0, 1), dtype=np.int64)
    late = counts_of_frames.late.sum(axis=0, dtype=np.int64)
    return {
        "frames": int(is_counted.sum()),
        "ratios": named_ratios(late, metric),
        "elsewhere": named_ratios(whole - late, metric),
        "support": supports(late),
    }


def _breakdowns(
    counts_of_frames: SubmissionCounts, cells: NDArray[np.int64], metric: str
) -> Iterator[tuple[str, Record]]:
    """Yield (kind, name → part) of each breakdown; kinds that no sequence has are left out."""
    rings = zip(RING_NAMES, cells.sum(axis=0), strict=True)
    yield "distance", {name: _part(ring, len(counts_of_frames.confusions), metric) for name, ring in rings}
    of_sequence = cells.sum(axis=1)
    is_chunked = any(facts.drive for facts in counts_of_frames.sequences)
    grouped: tuple[tuple[str, Callable[[SequenceFacts], str | None]], ...] = (
        ("sequence", lambda facts: facts.name),
        ("drive", lambda facts: facts.drive or (facts.name if is_chunked else None)),
        ("environment", lambda facts: facts.environment),
        ("illumination", lambda facts: facts.illumination),
    )
    for what, name_of in grouped:
        names = [name_of(facts) for facts in counts_of_frames.sequences]
        if any(names):
            yield what, _by_name(names, counts_of_frames.frames_of_sequence, of_sequence, metric)


def _by_name(names: Sequence[str | None], frames: Sequence[int], confusions: NDArray[np.int64], metric: str) -> Record:
    parts = {}
    for name in dict.fromkeys(name for name in names if name):
        rows = [row for row, other in enumerate(names) if other == name]
        parts[name] = _part(confusions[rows].sum(axis=0), sum(frames[row] for row in rows), metric)
    return parts


def _part(confusion: NDArray[np.int64], frames: int, metric: str) -> Record:
    return {**named_ratios(confusion, metric), "support": supports(confusion), "frames": frames}


# Intervals of a score in its record. By scope (`these_places`, `new_place`) and ratio, `intervals` has [low, high] or
# None, and `silences` the code of the reason for None (`stone.scoring.intervals`), or None.


Ratios = Mapping[str, float | None]


def spectra_of(confusions: Counts, frames_of_sequence: tuple[int, ...], metric: Metric) -> RatioSpectra:
    """Return the spectra of confusion matrices [F, ring, 4, 4], in time order within each sequence. Raises
    `ShapeError`.
    """
    return ratio_spectra(confusions.sum(axis=1, dtype=np.int64), frames_of_sequence, metric.version)


def interval_record(
    total: Ratios, spectra: RatioSpectra, metric: Metric, *, is_in_time_order: bool = True
) -> dict[str, Any]:
    """Return `intervals` and `silences` of a score's totals; a metric with withdrawn intervals has none.

    If the time order of frames is unknown, there is no interval for these places: correlated neighbours would count as
    independent, and the interval would be too narrow.
    """
    values = np.array([np.nan if total[name] is None else total[name] for name in RATIOS], np.float64)
    by_scope = {scope: estimates(values, spectra, scope) for scope in SCOPES}
    if not is_in_time_order:
        by_scope["these_places"] = tuple(UNKNOWN_ORDER if np.isfinite(value) else "undefined" for value in values)
    if metric.successor is not None:
        by_scope = dict.fromkeys(SCOPES, (WITHDRAWN,) * len(RATIOS))
    return {
        "intervals": {
            scope: dict(zip(RATIOS, map(_bounds, of_scope), strict=True)) for scope, of_scope in by_scope.items()
        },
        "silences": {
            scope: dict(zip(RATIOS, map(_silence, of_scope), strict=True)) for scope, of_scope in by_scope.items()
        },
    }


def _bounds(estimate: Estimate | Silence) -> list[float] | None:
    return None if isinstance(estimate, str) else list(estimate.ratio_interval())


def _silence(estimate: Estimate | Silence) -> Silence | None:
    return estimate if isinstance(estimate, str) else None
