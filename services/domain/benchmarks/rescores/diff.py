"""Differences made by a re-score: every entry and baseline by both evaluation versions, with rank changes.

**Conventions.** Ranks are computed over all entries, not only the best of each team, so that every move is visible. A
move in rank is old − new: positive moves up. A move in value is new − old of mIoU. Values are exact, so the differences
are for administrators only.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sqlalchemy.orm import Session

from services.domain.benchmarks.boards.entries import BoardEntry, BoardQuery, board_order_of, entries_on_board
from services.domain.benchmarks.phases.evaluation_versions import EvaluationVersion
from services.domain.benchmarks.rescores.progress import RescoreProgress
from services.domain.benchmarks.rescores.rescore import old_version
from services.runtime.orm import GroundTruthRow, Phase, Rescore

Ratios = Mapping[str, float | None]


@dataclass(frozen=True)
class RescoreSide:
    """One of the two evaluation versions; `truth_number` counts the ground truths of the phase."""

    truth_id: str
    truth_number: int
    metric: str


@dataclass(frozen=True)
class RescoreMove:
    """A submission by both evaluation versions; a side without a score, and values derived from it, are None."""

    submission_id: str
    team: str
    method: str
    modality: str
    kind: str
    old: Ratios | None
    new: Ratios | None
    old_rank: int | None
    new_rank: int | None

    @property
    def rank_move(self) -> int | None:
        """Ranks gained; negative if lost."""
        return None if self.old_rank is None or self.new_rank is None else self.old_rank - self.new_rank

    @property
    def value_move(self) -> float | None:
        """mIoU gained."""
        before, after = (side["miou"] if side else None for side in (self.old, self.new))
        return None if before is None or after is None else after - before


@dataclass(frozen=True)
class RescoreDiff:
    """`rows` are in the order of the new ranks, then rows without a new rank; `old` is None if no board existed."""

    old: RescoreSide | None
    new: RescoreSide
    rows: tuple[RescoreMove, ...]

    @property
    def largest_rank_move(self) -> int:
        """The most ranks that an entry gains or loses; 0 without entries."""
        return max((abs(row.rank_move) for row in self.rows if row.rank_move is not None), default=0)

    @property
    def largest_value_move(self) -> float:
        """The largest change of a submission's mIoU; 0 without submissions."""
        return max((abs(row.value_move) for row in self.rows if row.value_move is not None), default=0.0)

    @property
    def is_order_changed(self) -> bool:
        """Whether an entry has another rank, or is on only one of the boards."""
        return _order(self.rows, "old_rank") != _order(self.rows, "new_rank")

    @property
    def is_new_leader(self) -> bool:
        return _leaders(self.rows, "old_rank") != _leaders(self.rows, "new_rank")

    @property
    def without_new_score(self) -> int:
        """The number of submissions that have no new score (yet)."""
        return sum(row.new is None for row in self.rows)


def rescore_diff(session: Session, rescore: Rescore) -> RescoreDiff:
    """Return the current differences, complete or not; an activated re-score is compared with the version before it."""
    before, after = old_version(session, rescore), EvaluationVersion(rescore.truth_id, rescore.metric)
    phase = session.get_one(Phase, rescore.phase_id)
    old, new = (_entries(session, phase, pair) for pair in (before, after))
    old_ranks, new_ranks = _ranks(old), _ranks(new)
    rows = [
        _move_of(shown, (old.get(key), new.get(key)), (old_ranks.get(key), new_ranks.get(key)))
        for key, shown in {**old, **new}.items()
    ]
    last = len(rows) + 1
    rows.sort(key=lambda row: (row.new_rank or last, row.old_rank or last, row.submission_id))
    return RescoreDiff(_side(session, before) if before else None, _side(session, after), tuple(rows))


def _entries(session: Session, phase: Phase, pair: EvaluationVersion | None) -> dict[str, BoardEntry]:
    """Return the entries on the board by the evaluation version, by submission id."""
    entries = entries_on_board(session, phase, pair, BoardQuery(entries="all")) if pair else ()
    return {entry.submission_id: entry for entry in entries}


def _ranks(entries: Mapping[str, BoardEntry]) -> dict[str, int]:
    board = board_order_of(entries.values(), "all")
    return {entry.submission_id: rank for entry, rank in zip(board.ranked, board.ranks, strict=True)}


def _move_of(
    shown: BoardEntry, sides: tuple[BoardEntry | None, BoardEntry | None], ranks: tuple[int | None, int | None]
) -> RescoreMove:
    old, new = (side.ratios if side else None for side in sides)
    return RescoreMove(shown.submission_id, shown.team, shown.method, shown.modality, shown.kind, old, new, *ranks)


def _side(session: Session, pair: EvaluationVersion) -> RescoreSide:
    return RescoreSide(pair.truth_id, session.get_one(GroundTruthRow, pair.truth_id).number, pair.metric)


def _order(rows: Sequence[RescoreMove], rank: str) -> list[tuple[int, str]]:
    """Return (rank, submission id) of the ranked rows, sorted, so that equal ranks have a fixed order."""
    return sorted((getattr(row, rank), row.submission_id) for row in rows if getattr(row, rank) is not None)


def _leaders(rows: Sequence[RescoreMove], rank: str) -> set[str]:
    return {row.submission_id for row in rows if getattr(row, rank) == 1}


# The differences as a Markdown page for the administrator. Names and methods are untrusted: Markdown and HTML syntax is
# escaped. Ratios have four decimals, moves have a sign, and null is –.


SPECIAL = re.compile(r"([\\`*_{}\[\]()<>#+\-.!|~&$^=:\"'@/])")
HEAD = ("rank", "was", "move", "mIoU", "was", "change", "team", "method", "track", "submission")
NOTHING = "–"


def rescore_page(diff: RescoreDiff, progress: RescoreProgress, reason: str) -> str:
    """Return the page, with one row for each entry and baseline in the order of the new ranks."""
    old, new = (_version_cell(side) if side else "no board" for side in (diff.old, diff.new))
    table = [_row(HEAD), _row(("---",) * len(HEAD)), *(_row(_cells(moved)) for moved in diff.rows)]
    paragraphs = [f"# From {old} to {new}", f"Reason: {plain(reason)}", _progress(progress), _summary(diff)]
    return "\n\n".join([*paragraphs, "\n".join(table)]) + "\n"


def plain(text: str) -> str:
    """Return the text with all Markdown syntax escaped."""
    return SPECIAL.sub(r"\\\1", text)


def _version_cell(side: RescoreSide) -> str:
    return f"ground truth {side.truth_number} with {plain(side.metric)}"


def _progress(progress: RescoreProgress) -> str:
    parts = [
        f"{progress.scored} of {progress.total} submissions on the board have a score by the new evaluation version"
    ]
    parts += [f"still missing: {progress.missing}"] if progress.missing else []
    parts += [f"{progress.hidden} hidden submissions have no score"] if progress.hidden else []
    parts += (
        [f"the files of {progress.gone} were deleted, so these submissions leave the board"] if progress.gone else []
    )
    return "; ".join(parts) + "."


def _summary(diff: RescoreDiff) -> str:
    order = "changes" if diff.is_order_changed else "does not change"
    leader = "There is a new leader. " if diff.is_new_leader else "The leader stays. "
    largest = f"{diff.largest_rank_move} ranks and {diff.largest_value_move:.4f} of mIoU"
    return f"The order {order}. {leader}Largest moves: {largest}."


def _cells(moved: RescoreMove) -> tuple[str, ...]:
    miou = (side["miou"] if side else None for side in (moved.new, moved.old))
    values = tuple(NOTHING if value is None else f"{value:.4f}" for value in miou)
    ranks = (_whole(moved.new_rank), _whole(moved.old_rank), _format_signed(moved.rank_move, "d"))
    names = (plain(moved.team), plain(moved.method), moved.modality if moved.kind == "entry" else moved.kind)
    return (*ranks, *values, _format_signed(moved.value_move, ".4f"), *names, moved.submission_id)


def _whole(rank: int | None) -> str:
    return NOTHING if rank is None else str(rank)


def _format_signed(move: float | None, form: str) -> str:
    return NOTHING if move is None else f"{move:+{form}}" if move else "0"


def _row(cells: tuple[str, ...]) -> str:
    return f"| {' | '.join(cells)} |"
