"""The entries of a board at a time: which stand on it, in which order, with which rank.

**Conventions.** On a board are scored entries and baselines that had settled by then and were not withdrawn or hidden
then, with their score by the pair in force then. The order is by rounded mIoU, then IoU_occ, then IoU_N, then the time
of finalisation, earlier first; equal rounded values share a rank. Only finite entries are ranked: where a ratio is
undefined there is no rank, and baselines have none either. Texts are as participants wrote them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import Literal, get_args

from sqlalchemy import ColumnElement, and_, or_, select
from sqlalchemy.orm import Session, load_only

from services.runtime.benchmarks.pairs import Pair
from services.runtime.benchmarks.visibility import ON_BOARDS, is_on_board, rounded
from services.runtime.orm import Phase, Score, Submission, Team
from stone.metric import RATIOS
from stone.ranking import in_order, shared_ranks

Track = Literal["all", "C", "L", "R", "C+L", "C+R", "L+R", "C+L+R"]  # `modalities.Modality`, and all
Which = Literal["best", "all"]
Standing = Literal["ranked", "baseline", "undefined", "reported"]

TRACKS: tuple[Track, ...] = get_args(Track)
_SHOWN = (Submission.team_id, Submission.kind, Submission.method, Submission.modality, Submission.finalized_ns)
TIE_BREAK = ("miou", "iou_occ", "iou_n")


@dataclass(frozen=True)
class BoardQuery:
    """`track` is a declared modality, or all; `entries` the best of each team, or all; `as_of_ns` null for now."""

    track: Track = "all"
    as_of_ns: int | None = None
    entries: Which = "best"


@dataclass(frozen=True)
class Entry:
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
    draws_sha256: str
    ratios: Mapping[str, float | None]

    @cached_property
    def is_defined(self) -> bool:
        return all(value is not None and isfinite(value) for value in self.ratios.values())

    @property
    def standing(self) -> Standing:
        if self.kind == "baseline":
            return "baseline"
        return "ranked" if self.is_defined else "undefined"

    @cached_property
    def key(self) -> tuple[float, ...]:
        """What it is ordered by; what is undefined comes after everything."""
        if not self.is_defined:
            return (-1.0,) * len(TIE_BREAK)
        return tuple(rounded(self.ratios[name] or 0.0) for name in TIE_BREAK)


@dataclass(frozen=True)
class Ordered:
    """The entries of a board, best first: ranked ones with their ranks, then baselines, then undefined ones."""

    ranked: tuple[Entry, ...]
    ranks: tuple[int, ...]
    baselines: tuple[Entry, ...]
    undefined: tuple[Entry, ...]


def standing_entries(session: Session, phase: Phase, pair: Pair, query: BoardQuery) -> tuple[Entry, ...]:
    """What stands on the board by `pair`, in no particular order."""
    ratios = [getattr(Score, name) for name in RATIOS]
    found = (
        select(Score, Submission, Team.name)
        .options(load_only(Score.signature, Score.draws_sha256, *ratios), load_only(*_SHOWN))
        .join(Submission, Submission.id == Score.submission_id)
        .join(Team, Team.id == Submission.team_id)
        .where(Submission.phase_id == phase.id, Score.truth_id == pair.truth_id, Score.metric == pair.metric)
        .where(stood_at(query.as_of_ns))
    )
    if query.track != "all":
        found = found.where(Submission.modality == query.track)
    return tuple(_entry(*row) for row in session.execute(found))


def ordered(entries: Iterable[Entry], which: Which = "all") -> Ordered:
    """The entries in the order of the board; `best` keeps one of each team and all baselines."""
    best_first = _best_first(tuple(entries))
    of_standing: dict[Standing, list[Entry]] = {"ranked": [], "baseline": [], "undefined": []}
    seen: set[str] = set()
    for entry in best_first:
        is_further = which == "best" and entry.kind != "baseline" and entry.team_id in seen
        if not is_further:
            of_standing[entry.standing].append(entry)
            seen |= set() if entry.kind == "baseline" else {entry.team_id}
    ranks = shared_ranks([entry.key for entry in of_standing["ranked"]])
    return Ordered(
        tuple(of_standing["ranked"]), tuple(ranks), tuple(of_standing["baseline"]), tuple(of_standing["undefined"])
    )


def stood_at(as_of_ns: int | None) -> ColumnElement[bool]:
    """Whether a submission stands on the board now, or stood at a time of the past."""
    if as_of_ns is None:
        return is_on_board()
    return and_(
        Submission.state == "scored",
        Submission.kind.in_(ON_BOARDS),
        Submission.settled_ns <= as_of_ns,
        or_(Submission.withdrawn_ns.is_(None), Submission.withdrawn_ns > as_of_ns),
        or_(Submission.hidden_ns.is_(None), Submission.hidden_ns > as_of_ns),
    )


def _entry(score: Score, submission: Submission, team: str) -> Entry:
    return Entry(
        score_id=score.id,
        submission_id=submission.id,
        team_id=submission.team_id,
        team=team,
        kind=submission.kind,
        method=submission.method,
        modality=submission.modality,
        finalized_ns=submission.finalized_ns or 0,
        signature=score.signature,
        draws_sha256=score.draws_sha256,
        ratios={name: getattr(score, name) for name in RATIOS},
    )


def _best_first(entries: Sequence[Entry]) -> list[Entry]:
    earliest = sorted(entries, key=lambda entry: (entry.finalized_ns, entry.submission_id))
    return [earliest[place] for place in in_order([entry.key for entry in earliest])]
