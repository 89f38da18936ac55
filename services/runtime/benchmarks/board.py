"""The board of a phase: its entries in order, how surely each is where it is, and beside them what is not ranked.

**Conventions.** A board shows one pair of ground truth and metric, that in force at its time, so its scores have one
signature. What a viewer may not see of a row is null already here (`visibility.py`). At most `MOST_ROWS` entries of a
standing are told, the best ones; `ranked_total` says of how many. Draws are read after the rows, outside the
transaction.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.benchmarks.board_draws import Surety, surety_of
from services.runtime.benchmarks.board_entries import BoardQuery, Entry, Ordered, Standing, ordered, standing_entries
from services.runtime.benchmarks.pairs import Pair, in_force
from services.runtime.benchmarks.visibility import Secrecy, Viewer, policy_of, secrecy_of
from services.runtime.orm import Benchmark, Blob, GroundTruth, Phase, Reported, Score
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from stone.metric import RATIOS

MOST_ROWS = 2000
CHUNK = 500  # ids in one statement

Interval = tuple[float, float]
Ratios = Mapping[str, float | None]


@dataclass(frozen=True)
class Row:
    """A line of the board. `intervals` are of block draws, by ratio; `support` voxels of the ground truth by class."""

    standing: Standing
    method: str
    modality: str
    ratios: Ratios
    rank: int | None = None
    rank_interval: tuple[int, int] | None = None
    tie_group: int | None = None
    submission_id: str | None = None
    score_id: str | None = None
    team: str | None = None
    is_yours: bool = False
    intervals: Mapping[str, Interval | None] | None = None
    support: Mapping[str, int] | None = None
    source: str | None = None
    submitted_ns: int | None = None


@dataclass(frozen=True)
class ShownPair:
    """By what the scores of a board were made; `signature` is null while there is none."""

    truth_id: str
    truth_number: int
    truth_sha256: str
    metric: str
    signature: str | None
    activated_ns: int
    frames: int
    sequences: int


@dataclass(frozen=True)
class Board:
    """`pair` is null, and nothing stands on the board, before the phase's first ground truth."""

    benchmark: str
    phase: str
    query: BoardQuery
    secrecy: Secrecy
    is_hidden: bool
    pair: ShownPair | None
    ranked_total: int
    rows: tuple[Row, ...]


@dataclass(frozen=True)
class _Read:
    """What the database says of a board."""

    board: Board
    ordered: Ordered
    viewer: Viewer
    phase: Phase
    details: Mapping[str, tuple[Any, Any]]
    key_of: Mapping[str, str]
    reported: tuple[Row, ...]
    now_ns: int


def board(platform: Platform, phase_id: str, query: BoardQuery, viewer: Viewer) -> Board:
    """The board as the viewer may see it now; `as_of_ns` in the future is now. Raises `StoreAwayError`."""
    with platform.database.reading() as session:
        read = _read(session, session.get_one(Phase, phase_id), query, viewer)
    draws = [entry.draws_sha256 for entry in read.ordered.ranked]
    surety = surety_of(platform.store, draws, read.key_of) if draws else Surety((), ())
    return replace(read.board, rows=(*_ranked(read, surety), *_unranked(read), *read.reported))


def board_order(session: Session, phase: Phase, pair: Pair, query: BoardQuery) -> Ordered:
    """Who stands where by `pair`, in force or not: for administrators only, since nothing is left out."""
    return ordered(standing_entries(session, phase, pair, query), query.entries)


def sequences_of(truth: GroundTruth) -> int:
    """How many sequences a ground truth is of."""
    return len(truth.facts.get("sequences", ()))


def _read(session: Session, phase: Phase, query: BoardQuery, viewer: Viewer) -> _Read:
    now = now_ns()
    if query.as_of_ns is not None:
        query = replace(query, as_of_ns=min(query.as_of_ns, now))
    activation = in_force(session, phase.id, query.as_of_ns)
    entries = Ordered((), (), (), ())
    pair = None
    if activation is not None:
        entries = board_order(session, phase, Pair(activation.truth_id, activation.metric), query)
        truth = session.get_one(GroundTruth, activation.truth_id)
        pair = _shown_pair(truth, activation.metric, activation.activated_ns, entries)
    benchmark = session.get_one(Benchmark, phase.benchmark_id)
    at = (query, secrecy_of(phase, now), phase.is_hidden, pair, len(entries.ranked))
    empty = Board(benchmark.name, phase.name, *at, ())
    told = _bounded(entries)
    every = (*told.ranked, *told.baselines, *told.undefined)
    keys = _object_keys(session, [entry.draws_sha256 for entry in told.ranked])
    return _Read(empty, told, viewer, phase, _details(session, every), keys, _reported(session, phase, query), now)


def _bounded(entries: Ordered) -> Ordered:
    cut = slice(MOST_ROWS)
    return Ordered(entries.ranked[cut], entries.ranks[cut], entries.baselines[cut], entries.undefined[cut])


def _shown_pair(truth: GroundTruth, metric: str, activated_ns: int, entries: Ordered) -> ShownPair:
    every = (*entries.ranked, *entries.baselines, *entries.undefined)
    signature = every[0].signature if every else None
    of_truth = (truth.id, truth.number, truth.sha256)
    return ShownPair(*of_truth, metric, signature, activated_ns, truth.frames, sequences_of(truth))


def _details(session: Session, entries: Sequence[Entry]) -> dict[str, tuple[Any, Any]]:
    """Block intervals and supports by score, without the rest of the records."""
    found: dict[str, tuple[Any, Any]] = {}
    wanted = select(Score.id, Score.record["intervals"]["block"], Score.record["support"])
    for ids in _chunks([entry.score_id for entry in entries]):
        found |= {row[0]: (row[1], row[2]) for row in session.execute(wanted.where(Score.id.in_(ids)))}
    return found


def _object_keys(session: Session, shas: Sequence[str]) -> dict[str, str]:
    found: dict[str, str] = {}
    for some in _chunks(shas):
        found |= dict(session.execute(select(Blob.sha256, Blob.object_key).where(Blob.sha256.in_(some))).all())
    return found


def _chunks(values: Sequence[str]) -> Iterable[Sequence[str]]:
    return (values[start : start + CHUNK] for start in range(0, len(values), CHUNK))


def _reported(session: Session, phase: Phase, query: BoardQuery) -> tuple[Row, ...]:
    """What others published, the best first."""
    found = select(Reported).where(Reported.phase_id == phase.id)
    if query.as_of_ns is not None:
        found = found.where(Reported.created_ns <= query.as_of_ns)
    if query.track != "all":
        found = found.where(Reported.modality == query.track)
    rows = sorted(session.scalars(found), key=lambda row: (-(-1.0 if row.miou is None else row.miou), row.method))
    return tuple(
        Row("reported", row.method, row.modality, {name: getattr(row, name) for name in RATIOS}, source=row.source)
        for row in rows
    )


def _ranked(read: _Read, surety: Surety) -> Iterable[Row]:
    for place, (entry, rank) in enumerate(zip(read.ordered.ranked, read.ordered.ranks, strict=True)):
        row = replace(_row(read, entry), rank=rank)
        if policy_of(read.viewer, read.phase, entry.team_id, read.now_ns).shows("ranks"):
            row = replace(row, rank_interval=surety.rank_intervals[place], tie_group=surety.tie_groups[place])
        yield row


def _unranked(read: _Read) -> Iterable[Row]:
    return (_row(read, entry) for entry in (*read.ordered.baselines, *read.ordered.undefined))


def _row(read: _Read, entry: Entry) -> Row:
    policy = policy_of(read.viewer, read.phase, entry.team_id, read.now_ns)
    intervals, support = read.details[entry.score_id]
    return Row(
        standing=entry.standing,
        method=entry.method,
        modality=entry.modality,
        ratios={name: policy.ratio(value) for name, value in entry.ratios.items()},
        submission_id=entry.submission_id,
        score_id=entry.score_id,
        team=entry.team if policy.shows("team") else None,
        is_yours=entry.team_id in read.viewer.team_ids,
        intervals=intervals if policy.shows("intervals") else None,
        support=support if policy.shows("extras") else None,
        submitted_ns=entry.finalized_ns,
    )
