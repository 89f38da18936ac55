"""The leaderboard of a phase: ranked entries with rank confidence, followed by unranked rows.

**Conventions.** A board shows one evaluation version (ground truth and metric), the active one at its time, so all its
scores have one signature. Values that a viewer may not see are null (`visibility.py`). A board contains the best
`MOST_ROWS` entries of each status; `ranked_total` counts all of them. Spectra are read after the rows, outside the
transaction. Boards are cached in memory by their revision (`BoardRevision`), which is read for every request.
"""

from collections.abc import Hashable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from hashlib import sha256
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
from cachetools import LRUCache, cached
from sqlalchemy import select
from sqlalchemy.orm import Session, aliased

from services.domain.benchmarks.boards.comparison import read_spectra
from services.domain.benchmarks.boards.entries import (
    BoardEntry,
    BoardOrder,
    BoardQuery,
    EntryStatus,
    board_order_of,
    entries_on_board,
    was_on_board_at,
)
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion, in_force
from services.domain.benchmarks.phases.reported_results import is_reported_on
from services.domain.benchmarks.visibility import PERCENT_DIGITS, Secrecy, Viewer, policy_of, secrecy_of
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import (
    Activation,
    Benchmark,
    Blob,
    GroundTruthRow,
    Phase,
    Reported,
    Score,
    SubmissionRow,
    Team,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store.protocol import Store
from stone.scoring.confusion import danger
from stone.scoring.intervals import WITHDRAWN, Scope, Silence
from stone.scoring.metric import RATIOS
from stone.scoring.pairs import EntrySpectra, board_spectra, entry_spectra, surely_above
from stone.scoring.ranking import rank_intervals, tie_groups

# The revision of a board is a digest of all rows from which the board is made, read by three cached statements. Scores,
# ready ground truths and activations never change, so their ids represent them. The digest also covers whether the
# phase has ended, whether teams are named, and which teams are the viewer's. Boards of the past have no revision: such
# requests rarely repeat a time.


@dataclass(frozen=True)
class BoardRevision:
    """The digest of a board, and the viewer's teams on it; viewers with equal teams see equal boards."""

    digest: str
    teams: tuple[str, ...]


def board_revision(session: Session, phase_id: str, query: BoardQuery, viewer: Viewer, now_ns: int) -> BoardRevision:
    """Return the revision of the board that this viewer sees now. Raises `ValueError` for a board of the past."""
    if query.as_of_ns is not None:
        raise ValueError("boards of the past have no revision")
    (phase,) = _phase().rows(session, {"phase": phase_id})
    is_on_track = query.track != "all"
    at = {"phase": phase_id, **({"track": query.track} if is_on_track else {})}
    entries = _entries(is_on_track).rows(session, {**at, "truth": phase.truth_id, "metric": phase.metric})
    reported = _reported_revision(is_on_track).rows(session, at)
    teams = tuple(sorted({row.team_id for row in entries} & viewer.team_ids))
    times = [at_ns is not None and at_ns <= now_ns for at_ns in (phase.closes_ns, phase.named_from_ns)]
    read = [[tuple(row) for row in rows] for rows in ([phase], entries, reported)]
    whole = repr((query, viewer.is_administrator, teams, times, read))
    return BoardRevision(sha256(whole.encode()).hexdigest(), teams)


@cache
def _phase() -> KeptSelect:
    """Return the statement that reads the phase and its active evaluation version."""
    other = aliased(Activation)
    newest = select(other.id).where(other.phase_id == Phase.id).order_by(other.activated_ns.desc(), other.id.desc())
    columns = (Phase.id, Phase.name, Phase.is_hidden, Phase.closes_ns, Phase.named_from_ns, Benchmark.name)
    in_force = (Activation.id, Activation.truth_id, Activation.metric)
    phases = select(*columns, *in_force).join(Benchmark, Benchmark.id == Phase.benchmark_id)
    joined = phases.join(Activation, Activation.id == newest.limit(1).scalar_subquery(), isouter=True)
    return KeptSelect(joined.where(Phase.id == parameter("phase")))


@cache
def _entries(is_on_track: bool) -> KeptSelect:
    """Return the statement that reads scores on the board, and mutable columns of submissions and teams."""
    may_change = (SubmissionRow.kind, SubmissionRow.method, SubmissionRow.modality, SubmissionRow.finalized_ns)
    of_version = (Score.truth_id == parameter("truth"), Score.metric == parameter("metric"))
    rows = (
        select(Score.id, SubmissionRow.team_id, *may_change, Team.name)
        .join(SubmissionRow, SubmissionRow.id == Score.submission_id)
        .join(Team, Team.id == SubmissionRow.team_id)
        .where(SubmissionRow.phase_id == parameter("phase"), *of_version, was_on_board_at(None))
        .order_by(Score.id)
    )
    return KeptSelect(rows.where(SubmissionRow.modality == parameter("track")) if is_on_track else rows)


@cache
def _reported_revision(is_on_track: bool) -> KeptSelect:
    rows = select(*Reported.__table__.columns).where(Reported.phase_id == parameter("phase")).order_by(Reported.id)
    return KeptSelect(rows.where(is_reported_on(parameter("track"))) if is_on_track else rows)


# Rank confidence of leaderboard entries, from the stored spectra of their scores. Files are read from the store outside
# transactions. The spectra of the ranked ratio are cached by the sha256 of their blob, and results by the list of
# entries; the two caches hold about 16 MiB per process. Only the best `MOST_COMPARED` entries are compared.


RANKED_BY = RATIOS.index("miou")
READERS = 8
MOST_COMPARED = 500
MOST_KEPT = 3000
MOST_OUTCOMES = 64


@dataclass(frozen=True)
class RankConfidence:
    """Rank interval and tie group of each ranked entry, or null if unknown; `silence` is the reason if all are null.

    `scope` names the variances by which differences are tested.
    """

    rank_intervals: tuple[tuple[int, int] | None, ...]
    tie_groups: tuple[int | None, ...]
    silence: Silence | None = None
    scope: Scope | None = None


@dataclass(frozen=True)
class RankedScore:
    """An entry in board order: its ranked ratio, and the sha256 of its stored spectra."""

    value: float
    spectra_sha256: str


_SPECTRA: LRUCache[str, EntrySpectra | None] = LRUCache(MOST_KEPT)
_OUTCOMES: LRUCache[tuple[RankedScore, ...], RankConfidence] = LRUCache(MOST_OUTCOMES)


@cached(_OUTCOMES, key=lambda store, ranked, key_of: tuple(ranked), lock=Lock())
def rank_confidence_of(store: Store, ranked: Sequence[RankedScore], key_of: Mapping[str, str]) -> RankConfidence:
    """Return how certain the ranks of a board are; `key_of` gives the key of each blob. Raises `store_unavailable`."""
    compared = ranked[:MOST_COMPARED]
    with ThreadPoolExecutor(READERS) as readers:
        spectra = list(
            readers.map(lambda entry: _spectra(store, entry.spectra_sha256, key_of[entry.spectra_sha256]), compared)
        )
    known = [entry for entry in spectra if entry is not None]
    if len(known) < len(compared):
        return _silent(ranked, WITHDRAWN)
    if len(ranked) < 2:
        return _silent(ranked, None)
    claims = surely_above(np.array([entry.value for entry in compared]), board_spectra(known))
    if claims is None:
        return _silent(ranked, "few_frames")
    beneath = (None,) * (len(ranked) - len(compared))
    intervals = ((low, high + len(beneath)) for low, high in rank_intervals(claims.above).tolist())
    groups = (*tie_groups(claims.above).tolist(), *beneath)
    return RankConfidence((*intervals, *beneath), groups, scope=claims.scope)


def _silent(ranked: Sequence[RankedScore], silence: Silence | None) -> RankConfidence:
    nothing = (None,) * len(ranked)
    return RankConfidence(nothing, nothing, silence)


@cached(_SPECTRA, key=lambda store, sha256, object_key: sha256, lock=Lock())
def _spectra(store: Store, sha256: str, object_key: str) -> EntrySpectra | None:
    """Return the spectra of the ranked ratio only."""
    spectra = read_spectra(store, object_key)
    return None if spectra is None else entry_spectra(spectra, RANKED_BY)


MOST_ROWS = 2000
CHUNK = 500  # ids per statement
MOST_KEPT_ROWS = 10_000  # rows of all cached boards of a process, about 20 MiB

Interval = tuple[float, float]
Ratios = Mapping[str, float | None]


@dataclass(frozen=True)
class LeaderboardRow:
    """A line of the board.

    - `intervals`: by ratio, for these places
    - `support`: voxels of the ground truth by class
    - `danger`: shares of N voxels by name (`stone.scoring.confusion.DANGERS`)
    - `source`, `note`: only of a reported result or a ceiling
    - `percent_digits`: decimals of its printed percentages
    """

    standing: EntryStatus
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
    danger: Ratios | None = None
    source: str | None = None
    note: str | None = None
    percent_digits: int = PERCENT_DIGITS
    submitted_ns: int | None = None


@dataclass(frozen=True)
class BoardEvaluationVersion:
    """The evaluation version of a board's scores; `signature` is null while the board has no score.

    Sequences that continue each other form one of its `drives`.
    """

    truth_id: str
    truth_number: int
    truth_sha256: str
    metric: str
    signature: str | None
    activated_ns: int
    frames: int
    sequences: int
    drives: int


@dataclass(frozen=True)
class Board:
    """A leaderboard; `pair` is null, and the board is empty, before the phase's first ground truth.

    - `silence`: the reason if the board has neither ties nor rank intervals
    - `rank_scope`: scope of the variances behind ties and intervals
    - `revision`: empty for a board of the past
    """

    benchmark: str
    phase: str
    query: BoardQuery
    secrecy: Secrecy
    is_hidden: bool
    pair: BoardEvaluationVersion | None
    ranked_total: int
    rows: tuple[LeaderboardRow, ...]
    silence: Silence | None = None
    rank_scope: Scope | None = None
    revision: str = ""


class _ScoreDetails(NamedTuple):
    """Parts of a score's record."""

    intervals: Any
    support: Any
    confusion: Any


@dataclass(frozen=True)
class _BoardRecords:
    """The database rows of a board."""

    board: Board
    order: BoardOrder
    viewer: Viewer
    phase: Phase
    details: Mapping[str, _ScoreDetails]
    key_of: Mapping[str, str]
    reported: tuple[LeaderboardRow, ...]
    now_ns: int


_KEPT: LRUCache[Hashable, Board] = LRUCache(MOST_KEPT_ROWS, lambda board: 1 + len(board.rows))
_KEPT_LOCK = Lock()


def board(platform: Platform, phase_id: str, query: BoardQuery, viewer: Viewer) -> Board:
    """Return the board that the viewer may see now; a future `as_of_ns` means now. Raises `store_unavailable`."""
    if query.as_of_ns is None:
        return _kept_board(platform, phase_id, query, viewer)
    now = now_ns()
    with platform.database.reading() as session:
        read = _read_records(session, session.get_one(Phase, phase_id), query, viewer, now)
    return _make_board(platform, read)


def _kept_board(platform: Platform, phase_id: str, query: BoardQuery, viewer: Viewer) -> Board:
    """Return the board from the cache of newest boards per query and viewer; rows and digest are of one snapshot."""
    now = now_ns()
    with platform.database.snapshot() as session:
        revision = board_revision(session, phase_id, query, viewer, now)
        key = (phase_id, query, viewer.is_administrator, revision.teams)
        with _KEPT_LOCK:
            kept = _KEPT.get(key)
        if kept is not None and kept.revision == revision.digest:
            return kept
        read = _read_records(session, session.get_one(Phase, phase_id), query, viewer, now)
    made = replace(_make_board(platform, read), revision=revision.digest)
    if len(made.rows) < MOST_KEPT_ROWS:
        with _KEPT_LOCK:
            _KEPT[key] = made
    return made


def _make_board(platform: Platform, read: _BoardRecords) -> Board:
    ranked = [RankedScore(entry.ratios["miou"] or 0.0, entry.spectra_sha256) for entry in read.order.ranked]
    confidence = rank_confidence_of(platform.store, ranked, read.key_of) if ranked else RankConfidence((), ())
    ceilings = (row for row in read.reported if row.standing == "ceiling")
    published = (row for row in read.reported if row.standing == "reported")
    rows = (*ceilings, *_ranked_rows(read, confidence), *_unranked_rows(read), *published)
    return replace(read.board, rows=rows, silence=confidence.silence, rank_scope=confidence.scope)


def board_order(session: Session, phase: Phase, pair: EvaluationVersion, query: BoardQuery) -> BoardOrder:
    """Return the board's order by `pair`, active or not, without leaving anything out; for administrators only."""
    return board_order_of(entries_on_board(session, phase, pair, query), query.entries)


def sequences_of(truth: GroundTruthRow) -> int:
    """Return the number of sequences in a ground truth."""
    return len(truth.facts.get("sequences", ()))


def drives_of(truth: GroundTruthRow) -> int:
    """Return the number of drives in a ground truth."""
    facts = truth.facts.get("sequences", ())
    return len({(bool(sequence.get("drive")), sequence.get("drive") or sequence["name"]) for sequence in facts})


def _read_records(session: Session, phase: Phase, query: BoardQuery, viewer: Viewer, now: int) -> _BoardRecords:
    if query.as_of_ns is not None:
        query = replace(query, as_of_ns=min(query.as_of_ns, now))
    activation = in_force(session, phase.id, query.as_of_ns)
    entries = BoardOrder((), (), (), ())
    pair = None
    if activation is not None:
        entries = board_order(session, phase, EvaluationVersion(activation.truth_id, activation.metric), query)
        truth = session.get_one(GroundTruthRow, activation.truth_id)
        pair = _board_version(truth, activation.metric, activation.activated_ns, entries)
    benchmark = session.get_one(Benchmark, phase.benchmark_id)
    at = (query, secrecy_of(phase, now), phase.is_hidden, pair, len(entries.ranked))
    empty = Board(benchmark.name, phase.name, *at, ())
    shown = _bound_order(entries)
    every = (*shown.ranked, *shown.baselines, *shown.undefined)
    keys = _object_keys(session, [entry.spectra_sha256 for entry in shown.ranked])
    return _BoardRecords(
        empty, shown, viewer, phase, _details(session, every), keys, _reported_rows(session, phase, query), now
    )


def _bound_order(entries: BoardOrder) -> BoardOrder:
    cut = slice(MOST_ROWS)
    return BoardOrder(entries.ranked[cut], entries.ranks[cut], entries.baselines[cut], entries.undefined[cut])


def _board_version(
    truth: GroundTruthRow, metric: str, activated_ns: int, entries: BoardOrder
) -> BoardEvaluationVersion:
    every = (*entries.ranked, *entries.baselines, *entries.undefined)
    signature = every[0].signature if every else None
    of_truth, counts = (truth.id, truth.number, truth.sha256), (truth.frames, sequences_of(truth), drives_of(truth))
    return BoardEvaluationVersion(*of_truth, metric, signature, activated_ns, *counts)


def _details(session: Session, entries: Sequence[BoardEntry]) -> dict[str, _ScoreDetails]:
    """Return the details by score, without the rest of the records."""
    details_by_score: dict[str, _ScoreDetails] = {}
    parts = (Score.record["intervals"]["these_places"], Score.record["support"], Score.record["confusion"])
    for ids in _chunks([entry.score_id for entry in entries]):
        rows = session.execute(select(Score.id, *parts).where(Score.id.in_(ids)))
        details_by_score |= {score_id: _ScoreDetails(*details) for score_id, *details in rows}
    return details_by_score


def _object_keys(session: Session, shas: Sequence[str]) -> dict[str, str]:
    keys: dict[str, str] = {}
    for some in _chunks(shas):
        keys |= dict(session.execute(select(Blob.sha256, Blob.object_key).where(Blob.sha256.in_(some))).all())
    return keys


def _chunks(values: Sequence[str]) -> Iterable[Sequence[str]]:
    return (values[start : start + CHUNK] for start in range(0, len(values), CHUNK))


def _reported_rows(session: Session, phase: Phase, query: BoardQuery) -> tuple[LeaderboardRow, ...]:
    """Return the results published elsewhere and the ceilings, the best first."""
    rows_of_phase = select(Reported).where(Reported.phase_id == phase.id)
    if query.as_of_ns is not None:
        rows_of_phase = rows_of_phase.where(Reported.created_ns <= query.as_of_ns)
    if query.track != "all":
        rows_of_phase = rows_of_phase.where(is_reported_on(query.track))
    rows = sorted(
        session.scalars(rows_of_phase), key=lambda row: (-(-1.0 if row.miou is None else row.miou), row.method)
    )
    return tuple(
        LeaderboardRow(
            "ceiling" if row.kind == "ceiling" else "reported",
            row.method,
            row.modality,
            {name: getattr(row, name) for name in RATIOS},
            source=row.source,
            note=row.note or None,
            percent_digits=row.percent_digits,
        )
        for row in rows
    )


def _ranked_rows(read: _BoardRecords, confidence: RankConfidence) -> Iterable[LeaderboardRow]:
    for index, (entry, rank) in enumerate(zip(read.order.ranked, read.order.ranks, strict=True)):
        row = replace(_row(read, entry), rank=rank)
        if policy_of(read.viewer, read.phase, entry.team_id, read.now_ns).shows("ranks"):
            row = replace(row, rank_interval=confidence.rank_intervals[index], tie_group=confidence.tie_groups[index])
        yield row


def _unranked_rows(read: _BoardRecords) -> Iterable[LeaderboardRow]:
    return (_row(read, entry) for entry in (*read.order.baselines, *read.order.undefined))


def _row(read: _BoardRecords, entry: BoardEntry) -> LeaderboardRow:
    policy = policy_of(read.viewer, read.phase, entry.team_id, read.now_ns)
    details = read.details[entry.score_id]
    return LeaderboardRow(
        standing=entry.standing,
        method=entry.method,
        modality=entry.modality,
        ratios={name: policy.ratio(value) for name, value in entry.ratios.items()},
        submission_id=entry.submission_id,
        score_id=entry.score_id,
        team=entry.team if policy.shows("team") else None,
        is_yours=entry.team_id in read.viewer.team_ids,
        intervals=details.intervals if policy.shows("intervals") else None,
        support=details.support if policy.shows("extras") else None,
        danger=danger(np.array(details.confusion)) if policy.shows("extras") else None,
        submitted_ns=entry.finalized_ns,
    )
