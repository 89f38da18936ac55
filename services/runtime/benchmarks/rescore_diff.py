"""What a re-score would change, or has changed: every standing submission by both pairs, with its moves.

**Conventions.** Ranks are of all entries of the phase in the order of its board (every entry by itself, not the best of
its team), so that every move is seen; baselines and hidden entries have none. A move in rank is old − new: positive
moves up. A move in value is new − old of mIoU. For administrators only: values are exact.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.benchmarks.pairs import Pair
from services.runtime.benchmarks.rescore_progress import standing_ids
from services.runtime.benchmarks.rescoring import old_pair
from services.runtime.benchmarks.visibility import is_on_board, rounded, secrecy_of
from services.runtime.orm import GroundTruth, Phase, Rescore, Score, Submission, Team
from services.runtime.orm.base import now_ns
from stone.metric import RATIOS
from stone.ranking import in_order, shared_ranks

Ratios = Mapping[str, float | None]
RANKED_BY = ("miou", "iou_occ", "iou_n")


@dataclass(frozen=True)
class Side:
    """One of the two pairs; `truth_number` counts the ground truths of the phase."""

    truth_id: str
    truth_number: int
    metric: str


@dataclass(frozen=True)
class Moved:
    """A submission by both pairs; a side without a score, and what follows from it, is None."""

    submission_id: str
    team: str
    method: str
    modality: str
    kind: str
    is_hidden: bool
    old: Ratios | None
    new: Ratios | None
    old_rank: int | None
    new_rank: int | None

    @property
    def rank_move(self) -> int | None:
        """Ranks gained; negative: lost."""
        return None if self.old_rank is None or self.new_rank is None else self.old_rank - self.new_rank

    @property
    def value_move(self) -> float | None:
        """mIoU gained."""
        before, after = (side["miou"] if side else None for side in (self.old, self.new))
        return None if before is None or after is None else after - before


@dataclass(frozen=True)
class RescoreDiff:
    """`rows` in the order of the new ranks, then what has no new rank; `old` is None where no board stood before."""

    old: Side | None
    new: Side
    rows: tuple[Moved, ...]

    @property
    def largest_rank_move(self) -> int:
        """The most ranks that any entry gains or loses; 0 of none."""
        return max((abs(row.rank_move) for row in self.rows if row.rank_move is not None), default=0)

    @property
    def largest_value_move(self) -> float:
        """The most that the mIoU of any submission changes by; 0 of none."""
        return max((abs(row.value_move) for row in self.rows if row.value_move is not None), default=0.0)

    @property
    def is_order_changed(self) -> bool:
        """Whether any entry has another rank, or stands on one of the boards only."""
        return _order(self.rows, "old_rank") != _order(self.rows, "new_rank")

    @property
    def is_new_leader(self) -> bool:
        return _leaders(self.rows, "old_rank") != _leaders(self.rows, "new_rank")

    @property
    def without_new_score(self) -> int:
        """How many submissions have not got, or cannot get, a new score."""
        return sum(row.new is None for row in self.rows)


def rescore_diff(session: Session, rescore: Rescore) -> RescoreDiff:
    """The difference as it stands now, complete or not; of an activated re-score against the pair before it."""
    before, after = old_pair(session, rescore), Pair(rescore.truth_id, rescore.metric)
    phase = session.get_one(Phase, rescore.phase_id)
    ids = standing_ids(session, phase.id)
    old, new = (_ratios(session, pair) if pair else {} for pair in (before, after))
    ranked = _ranked_ids(session, phase.id)
    old_ranks, new_ranks = (_ranks(ranked, ratios, phase) for ratios in (old, new))
    facts = select(Submission, Team.name).join(Team, Team.id == Submission.team_id).where(Submission.id.in_(ids))
    rows = [
        _moved(one, team, (old.get(one.id), new.get(one.id)), (old_ranks.get(one.id), new_ranks.get(one.id)))
        for one, team in session.execute(facts).all()
    ]
    rows.sort(key=lambda row: (row.new_rank or len(rows) + 1, row.old_rank or len(rows) + 1, row.submission_id))
    return RescoreDiff(_side(session, before) if before else None, _side(session, after), tuple(rows))


def _ratios(session: Session, pair: Pair) -> dict[str, Ratios]:
    """The scores of the phase by this pair, by submission."""
    columns = [getattr(Score, name) for name in RATIOS]
    by_pair = select(Score.submission_id, *columns).where(Score.truth_id == pair.truth_id, Score.metric == pair.metric)
    return {row[0]: dict(zip(RATIOS, row[1:], strict=True)) for row in session.execute(by_pair)}


def _ranked_ids(session: Session, phase_id: str) -> list[str]:
    """The entries that may be ranked, the earlier first."""
    ranked = select(Submission.id).where(Submission.phase_id == phase_id, is_on_board(), Submission.kind == "entry")
    return list(session.scalars(ranked.order_by(Submission.finalized_ns, Submission.id)))


def _ranks(ids: Sequence[str], ratios: Mapping[str, Ratios], phase: Phase) -> dict[str, int]:
    """The rank of each of `ids` that has all ratios of the order; rounded where the board is."""
    is_rounded = secrecy_of(phase, now_ns()) == "running"
    found = {one: [ratios[one][name] for name in RANKED_BY] for one in ids if one in ratios}
    known = {one: [value for value in values if value is not None] for one, values in found.items()}
    keys = {one: values for one, values in known.items() if len(values) == len(RANKED_BY)}
    shown = [[rounded(value) if is_rounded else value for value in values] for values in keys.values()]
    order = in_order(shown)
    ranks = shared_ranks([shown[place] for place in order])
    named = list(keys)
    return {named[place]: rank for place, rank in zip(order, ranks, strict=True)}


def _moved(
    submission: Submission, team: str, sides: tuple[Ratios | None, Ratios | None], ranks: tuple[int | None, int | None]
) -> Moved:
    facts = (submission.id, team, submission.method, submission.modality, submission.kind)
    return Moved(*facts, submission.hidden_ns is not None, *sides, *ranks)


def _side(session: Session, pair: Pair) -> Side:
    return Side(pair.truth_id, session.get_one(GroundTruth, pair.truth_id).number, pair.metric)


def _order(rows: Sequence[Moved], rank: str) -> list[tuple[int, str]]:
    """Who stands on a board with which rank; equal ranks by id, so that only a true change is one."""
    return sorted((getattr(row, rank), row.submission_id) for row in rows if getattr(row, rank) is not None)


def _leaders(rows: Sequence[Moved], rank: str) -> set[str]:
    return {row.submission_id for row in rows if getattr(row, rank) == 1}
