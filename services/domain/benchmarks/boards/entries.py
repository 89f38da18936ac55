"""The entries of a leaderboard at a given time, ordered and ranked.

**Conventions.** A board contains the scored entries and baselines that had settled by that time and were not withdrawn
or hidden. Their score is that of the evaluation version active at that time. Entries are ordered by rounded mIoU, then
IoU_occ, then IoU_N, then time of finalisation, earlier first; equal rounded values share a rank. Entries with an
undefined ratio and baselines have no rank. Texts are as participants wrote them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Literal, get_args

from sqlalchemy import ColumnElement, and_, or_, select
from sqlalchemy.orm import Session, load_only

from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.visibility import ON_BOARDS, is_on_board, rounded
from services.runtime.orm import Phase, Score, SubmissionRow, Team
from stone.scoring.metric import RATIOS
from stone.scoring.ranking import in_order, shared_ranks

Track = Literal["all", "C", "L", "R", "C+L", "C+R", "L+R", "C+L+R"]  # a `modalities.Modality`, or all
Which = Literal["best", "all"]
EntryStatus = Literal["ranked", "baseline", "undefined", "reported", "ceiling"]

TRACKS: tuple[Track, ...] = get_args(Track)
_SHOWN = (
    SubmissionRow.team_id,
    SubmissionRow.kind,
    SubmissionRow.method,
    SubmissionRow.modality,
    SubmissionRow.finalized_ns,
)
TIE_BREAK = ("miou", "iou_occ", "iou_n")


@dataclass(frozen=True)
class BoardQuery:
    """`track`: a declared modality, or all; `entries`: the best of each team, or all; `as_of_ns`: null for now."""

    track: Track = "all"
    as_of_ns: int | None = None
    entries: Which = "best"


@dataclass(frozen=True)
class BoardEntry:
    """A score on a board, without its record."""

    score_id: str
    submission_id: str
    team_id: str
    team: str
    kind: str
    method: str
    modality: str
    finalized_ns: int
    signature: str
    spectra_sha256: str
    ratios: Mapping[str, float | None]

    @cached_property
    def is_defined(self) -> bool:
        return all(value is not None and isfinite(value) for value in self.ratios.values())

    @property
    def standing(self) -> EntryStatus:
        if self.kind == "baseline":
            return "baseline"
        return "ranked" if self.is_defined else "undefined"

    @cached_property
    def key(self) -> tuple[float, ...]:
        """The sort key; undefined values come last."""
        if not self.is_defined:
            return (-1.0,) * len(TIE_BREAK)
        return tuple(rounded(self.ratios[name] or 0.0) for name in TIE_BREAK)


@dataclass(frozen=True)
class BoardOrder:
    """The entries of a board, best first: ranked entries with their ranks, then baselines, then undefined entries."""

    ranked: tuple[BoardEntry, ...]
    ranks: tuple[int, ...]
    baselines: tuple[BoardEntry, ...]
    undefined: tuple[BoardEntry, ...]


def entries_on_board(
    session: Session, phase: Phase, pair: EvaluationVersion, query: BoardQuery
) -> tuple[BoardEntry, ...]:
    """Return the entries on the board by `pair`, unordered."""
    ratios = [getattr(Score, name) for name in RATIOS]
    rows = (
        select(Score, SubmissionRow, Team.name)
        .options(load_only(Score.signature, Score.spectra_sha256, *ratios), load_only(*_SHOWN))
        .join(SubmissionRow, SubmissionRow.id == Score.submission_id)
        .join(Team, Team.id == SubmissionRow.team_id)
        .where(SubmissionRow.phase_id == phase.id, Score.truth_id == pair.truth_id, Score.metric == pair.metric)
        .where(was_on_board_at(query.as_of_ns))
    )
    if query.track != "all":
        rows = rows.where(SubmissionRow.modality == query.track)
    return tuple(_entry(*row) for row in session.execute(rows))


def board_order_of(entries: Iterable[BoardEntry], which: Which = "all") -> BoardOrder:
    """Return the entries in board order; `best` keeps the best of each team and all baselines."""
    best_first = _best_first(tuple(entries))
    by_status: dict[EntryStatus, list[BoardEntry]] = {"ranked": [], "baseline": [], "undefined": []}
    seen: set[str] = set()
    for entry in best_first:
        is_further = which == "best" and entry.kind != "baseline" and entry.team_id in seen
        if not is_further:
            by_status[entry.standing].append(entry)
            seen |= set() if entry.kind == "baseline" else {entry.team_id}
    ranks = shared_ranks([entry.key for entry in by_status["ranked"]])
    return BoardOrder(
        tuple(by_status["ranked"]), tuple(ranks), tuple(by_status["baseline"]), tuple(by_status["undefined"])
    )


def was_on_board_at(as_of_ns: int | None) -> ColumnElement[bool]:
    """Return the condition that a submission is on the board now, or was on it at a past time."""
    if as_of_ns is None:
        return is_on_board()
    return and_(
        SubmissionRow.state == "scored",
        SubmissionRow.kind.in_(ON_BOARDS),
        SubmissionRow.settled_ns <= as_of_ns,
        or_(SubmissionRow.withdrawn_ns.is_(None), SubmissionRow.withdrawn_ns > as_of_ns),
        or_(SubmissionRow.hidden_ns.is_(None), SubmissionRow.hidden_ns > as_of_ns),
    )


def _entry(score: Score, submission: SubmissionRow, team: str) -> BoardEntry:
    return BoardEntry(
        score_id=score.id,
        submission_id=submission.id,
        team_id=submission.team_id,
        team=team,
        kind=submission.kind,
        method=submission.method,
        modality=submission.modality,
        finalized_ns=submission.finalized_ns or 0,
        signature=score.signature,
        spectra_sha256=score.spectra_sha256,
        ratios={name: getattr(score, name) for name in RATIOS},
    )


def _best_first(entries: Sequence[BoardEntry]) -> list[BoardEntry]:
    earliest = sorted(entries, key=lambda entry: (entry.finalized_ns, entry.submission_id))
    return [earliest[index] for index in in_order([entry.key for entry in earliest])]
