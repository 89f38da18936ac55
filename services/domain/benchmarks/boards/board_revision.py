"""The revision of a board: a digest of every row that it is made of, by three statements that are kept.

**Conventions.** Equal revisions, equal boards. A score, a ground truth that is ready and an activation never change, so
their ids stand for them; whatever else a board tells is in the digest as it was read, and with it whether its phase is
over, whether teams are named by now, and which of the teams on it are the viewer's. Boards of the past have none: those
that ask for a time ask for another one each.
"""

from dataclasses import dataclass
from functools import cache
from hashlib import sha256

from sqlalchemy import select
from sqlalchemy.orm import Session, aliased

from services.domain.benchmarks.boards.entries import BoardQuery, was_on_board_at
from services.domain.benchmarks.visibility import Viewer
from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import Activation, Benchmark, Phase, Reported, Score, SubmissionRow, Team


@dataclass(frozen=True)
class BoardRevision:
    """The digest of a board, and the teams on it that are the viewer's, who sees what others with them see."""

    digest: str
    teams: tuple[str, ...]


def board_revision(session: Session, phase_id: str, query: BoardQuery, viewer: Viewer, now_ns: int) -> BoardRevision:
    """Of the board as this viewer sees it now. Raises `ValueError` for a board of the past."""
    if query.as_of_ns is not None:
        raise ValueError("boards of the past have no revision")
    (phase,) = _phase().rows(session, {"phase": phase_id})
    is_on_track = query.track != "all"
    at = {"phase": phase_id, **({"track": query.track} if is_on_track else {})}
    entries = _entries(is_on_track).rows(session, {**at, "truth": phase.truth_id, "metric": phase.metric})
    reported = _reported(is_on_track).rows(session, at)
    teams = tuple(sorted({row.team_id for row in entries} & viewer.team_ids))
    times = [at_ns is not None and at_ns <= now_ns for at_ns in (phase.closes_ns, phase.named_from_ns)]
    read = [[tuple(row) for row in rows] for rows in ([phase], entries, reported)]
    whole = repr((query, viewer.is_administrator, teams, times, read))
    return BoardRevision(sha256(whole.encode()).hexdigest(), teams)


@cache
def _phase() -> KeptSelect:
    """What the phase says, and the evaluation version that is in force."""
    other = aliased(Activation)
    newest = select(other.id).where(other.phase_id == Phase.id).order_by(other.activated_ns.desc(), other.id.desc())
    said = (Phase.id, Phase.name, Phase.is_hidden, Phase.closes_ns, Phase.named_from_ns, Benchmark.name)
    in_force = (Activation.id, Activation.truth_id, Activation.metric)
    phases = select(*said, *in_force).join(Benchmark, Benchmark.id == Phase.benchmark_id)
    joined = phases.join(Activation, Activation.id == newest.limit(1).scalar_subquery(), isouter=True)
    return KeptSelect(joined.where(Phase.id == parameter("phase")))


@cache
def _entries(is_on_track: bool) -> KeptSelect:
    """The scores that stand on the board, with what may change of their submissions and teams."""
    may_change = (SubmissionRow.kind, SubmissionRow.method, SubmissionRow.modality, SubmissionRow.finalized_ns)
    of_version = (Score.truth_id == parameter("truth"), Score.metric == parameter("metric"))
    found = (
        select(Score.id, SubmissionRow.team_id, *may_change, Team.name)
        .join(SubmissionRow, SubmissionRow.id == Score.submission_id)
        .join(Team, Team.id == SubmissionRow.team_id)
        .where(SubmissionRow.phase_id == parameter("phase"), *of_version, was_on_board_at(None))
        .order_by(Score.id)
    )
    return KeptSelect(found.where(SubmissionRow.modality == parameter("track")) if is_on_track else found)


@cache
def _reported(is_on_track: bool) -> KeptSelect:
    found = select(*Reported.__table__.columns).where(Reported.phase_id == parameter("phase")).order_by(Reported.id)
    return KeptSelect(found.where(Reported.modality == parameter("track")) if is_on_track else found)
