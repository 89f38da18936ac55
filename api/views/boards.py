"""Boards and comparisons as response bodies and files.

**Conventions.** Nothing is decided here about who sees what: that was done where the rows were read. What is written of
a board is kept under its revision, which is another one for who sees another board.
"""

from dataclasses import asdict
from threading import Lock

from cachetools import LRUCache
from fastapi import Request, Response
from sqlalchemy.orm import Session

from api.compression import tagged_response
from api.files import safe_name
from api.schemas.base import instant, instant_or_none
from api.schemas.leaderboard import (
    BoardPairItem,
    BoardRow,
    ChangeItem,
    ComparisonAnswer,
    DifferenceItem,
    Form,
    HistoryAnswer,
    IntervalsItem,
    LeaderboardAnswer,
    PairItem,
    RatioDifferenceItem,
    RatiosItem,
    SignFlipItem,
    SupportItem,
)
from services.domain.benchmarks.boards.board import Board, BoardEvaluationVersion, LeaderboardRow, sequences_of
from services.domain.benchmarks.boards.comparison import DifferenceEstimate, EntryComparison, RatioDifference
from services.domain.benchmarks.boards.entries import TIE_BREAK, Track
from services.domain.benchmarks.boards.history import history
from services.domain.benchmarks.boards.tables import MEDIA_TYPES, notes, table_bytes
from services.domain.benchmarks.submissions.results import ScoreView
from services.domain.benchmarks.visibility import RATIO_DIGITS, Viewer
from services.runtime.orm import Benchmark, Phase
from stone.scoring.intervals import LEVEL

JSON_TYPE = "application/json"
MOST_KEPT_BYTES = 4 * 2**20  # of all boards

_WRITTEN: LRUCache[tuple[str, Form], bytes] = LRUCache(MOST_KEPT_BYTES, len)
_WRITTEN_LOCK = Lock()


def board_response(request: Request, board: Board, viewer: Viewer, form: Form) -> Response:
    """The board in this form, or 304 to who has it already."""
    content, headers = _board_bytes(board, viewer, form), {"Cache-Control": "private, no-cache"}
    if form == "json":
        return tagged_response(request, content, JSON_TYPE, headers)
    named = safe_name(f"{board.benchmark}-{board.phase}.{form}")
    headers["Content-Disposition"] = f'attachment; filename="{named}"'
    return tagged_response(request, content, MEDIA_TYPES[form], headers)


def _board_bytes(board: Board, viewer: Viewer, form: Form) -> bytes:
    """The board in this form, written once for each revision of it."""
    key = (board.revision, form)
    with _WRITTEN_LOCK:
        kept = _WRITTEN.get(key)
    if kept is not None:
        return kept
    written = board_answer(board, viewer).model_dump_json().encode() if form == "json" else table_bytes(board, form)
    if board.revision and len(written) < MOST_KEPT_BYTES:
        with _WRITTEN_LOCK:
            _WRITTEN[key] = written
    return written


def board_answer(board: Board, viewer: Viewer) -> LeaderboardAnswer:
    return LeaderboardAnswer(
        benchmark=board.benchmark,
        phase=board.phase,
        track=board.query.track,
        entries=board.query.entries,
        as_of=instant_or_none(board.query.as_of_ns),
        is_hidden=board.is_hidden,
        secrecy=board.secrecy,
        is_rounded=board.secrecy == "running" and not viewer.is_administrator,
        ratio_digits=RATIO_DIGITS,
        ordered_by=[*TIE_BREAK, "submitted_at"],
        interval_level=LEVEL,
        pair=_board_version_item(board.pair) if board.pair else None,
        ranked_total=board.ranked_total,
        rows=[_row(row) for row in board.rows],
        notes=list(notes(board)),
    )


def history_answer(session: Session, phase: Phase, track: Track) -> HistoryAnswer:
    """When the board of a track changed."""
    return HistoryAnswer(
        benchmark=session.get_one(Benchmark, phase.benchmark_id).name,
        phase=phase.name,
        track=track,
        changes=[
            ChangeItem(
                at=instant(one.at_ns),
                entered=one.entered,
                left=one.left,
                is_new_pair=one.is_new_pair,
                best_miou=one.best,
            )
            for one in history(session, phase, track)
        ],
    )


def evaluation_version_item(seen: ScoreView) -> PairItem:
    """The evaluation version that a score was made by."""
    return PairItem(
        ground_truth=seen.truth.number,
        ground_truth_sha256=seen.truth.sha256,
        metric=seen.score.metric,
        signature=seen.score.signature,
        frames=seen.truth.frames,
        sequences=sequences_of(seen.truth),
    )


def comparison_answer(comparison: EntryComparison) -> ComparisonAnswer:
    return ComparisonAnswer(
        a=comparison.a.submission.id,
        b=comparison.b.submission.id,
        pair=evaluation_version_item(comparison.a),
        is_withheld=comparison.is_withheld,
        interval_level=LEVEL,
        ratios={name: _compared(found) for name, found in comparison.ratios.items()},
    )


def _board_version_item(pair: BoardEvaluationVersion) -> BoardPairItem:
    return BoardPairItem(
        ground_truth=pair.truth_number,
        ground_truth_sha256=pair.truth_sha256,
        metric=pair.metric,
        signature=pair.signature,
        frames=pair.frames,
        sequences=pair.sequences,
        activated_at=instant(pair.activated_ns),
    )


def _row(row: LeaderboardRow) -> BoardRow:
    return BoardRow(
        standing=row.standing,
        rank=row.rank,
        rank_interval=row.rank_interval,
        tie_group=row.tie_group,
        submission_id=row.submission_id,
        score_id=row.score_id,
        team=row.team,
        is_yours=row.is_yours,
        method=row.method,
        modality=row.modality,
        ratios=RatiosItem(**row.ratios),
        intervals=None if row.intervals is None else IntervalsItem(**row.intervals),
        support=None if row.support is None else SupportItem(**row.support),
        source=row.source,
        note=row.note,
        percent_digits=row.percent_digits,
        submitted_at=instant_or_none(row.submitted_ns),
    )


def _compared(found: RatioDifference) -> RatioDifferenceItem:
    return RatioDifferenceItem(
        a=found.a,
        b=found.b,
        difference=found.difference,
        these_places=_difference(found.these_places),
        new_place=_difference(found.new_place),
        silences=None if found.silences is None else dict(found.silences),
        sign_flip=None if found.sign_flip is None else SignFlipItem(**asdict(found.sign_flip)),
    )


def _difference(found: DifferenceEstimate | None) -> DifferenceItem | None:
    return None if found is None else DifferenceItem(**asdict(found))
