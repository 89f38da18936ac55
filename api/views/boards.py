"""Boards and comparisons as response bodies and files.

**Conventions.** Visibility was applied where the rows were read. The written form of a board is cached under its
revision, which differs for viewers who see another board.
"""

from threading import Lock

from cachetools import LRUCache
from fastapi import Request, Response
from sqlalchemy.orm import Session

from api.compression import tagged_response
from api.files import safe_name
from api.schemas.leaderboard import (
    ChangeItem,
    ComparisonAnswer,
    Form,
    HistoryAnswer,
    LeaderboardAnswer,
    PairItem,
)
from services.domain.benchmarks.boards.board import Board, drives_of, sequences_of
from services.domain.benchmarks.boards.comparison import EntryComparison
from services.domain.benchmarks.boards.entries import TIE_BREAK, Track
from services.domain.benchmarks.boards.history import history
from services.domain.benchmarks.boards.tables import MEDIA_TYPES, notes, table_bytes
from services.domain.benchmarks.submissions.results import ScoreView
from services.domain.benchmarks.visibility import RATIO_DIGITS, Viewer
from services.runtime.orm import Benchmark, Phase
from stone.scoring.intervals import LEVEL

JSON_TYPE = "application/json"
MOST_KEPT_BYTES = 4 * 2**20  # for all boards together

_WRITTEN: LRUCache[tuple[str, Form], bytes] = LRUCache(MOST_KEPT_BYTES, len)
_WRITTEN_LOCK = Lock()


def board_response(request: Request, board: Board, viewer: Viewer, form: Form) -> Response:
    """Return the board in this form, or 304 if the client's copy is current."""
    content, headers = _board_bytes(board, viewer, form), {"Cache-Control": "private, no-cache"}
    if form == "json":
        return tagged_response(request, content, JSON_TYPE, headers)
    named = safe_name(f"{board.benchmark}-{board.phase}.{form}")
    headers["Content-Disposition"] = f'attachment; filename="{named}"'
    return tagged_response(request, content, MEDIA_TYPES[form], headers)


def _board_bytes(board: Board, viewer: Viewer, form: Form) -> bytes:
    """Return the board in this form, written once for each revision."""
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
    return LeaderboardAnswer.of(
        board,
        track=board.query.track,
        entries=board.query.entries,
        as_of=board.query.as_of_ns,
        is_rounded=board.secrecy == "running" and not viewer.is_administrator,
        ratio_digits=RATIO_DIGITS,
        ordered_by=[*TIE_BREAK, "submitted_at"],
        interval_level=LEVEL,
        notes=list(notes(board)),
    )


def history_answer(session: Session, phase: Phase, track: Track) -> HistoryAnswer:
    """Return the changes of a track's board."""
    return HistoryAnswer(
        benchmark=session.get_one(Benchmark, phase.benchmark_id).name,
        phase=phase.name,
        track=track,
        changes=[ChangeItem.of(change, best_miou=change.best) for change in history(session, phase, track)],
    )


def evaluation_version_item(seen: ScoreView) -> PairItem:
    """Return the evaluation version of a score."""
    return PairItem.of(
        seen.score,
        ground_truth=seen.truth.number,
        ground_truth_sha256=seen.truth.sha256,
        frames=seen.truth.frames,
        sequences=sequences_of(seen.truth),
        drives=drives_of(seen.truth),
    )


def comparison_answer(comparison: EntryComparison) -> ComparisonAnswer:
    return ComparisonAnswer.of(
        comparison,
        a=comparison.a.submission.id,
        b=comparison.b.submission.id,
        pair=evaluation_version_item(comparison.a),
        interval_level=LEVEL,
    )
