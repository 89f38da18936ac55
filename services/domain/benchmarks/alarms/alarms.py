"""Alarms for administrators: equal predictions of several teams, probing by near-identical submissions, impossible
counts, and predictions that cannot follow from the frame's inputs.

**Conventions.** An alarm has a subject: the later of two submissions, or a team's day. It is raised once, whatever the
order and number of scorings. Withdrawn and hidden entries count. Baselines count only if the ground truth is hidden,
because probing with a baseline would reveal as much as with an entry.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import Select, select, text
from sqlalchemy.orm import Session, aliased

from services.domain.benchmarks.rescores.errors import AlarmDismissedError
from services.domain.benchmarks.submissions.scoring_quota import is_charged
from services.domain.benchmarks.visibility import ON_BOARDS
from services.runtime.database.inserts import insert_new
from services.runtime.orm import Alarm, Phase, Score, SubmissionRow, Team
from services.runtime.orm.base import new_id, now_ns
from stone.errors import Refused

# Similarity of scored entries by their confusion counts. The distance of two submissions to one ground truth is half
# the sum of the absolute differences of their counts by sequence, ring and cell, per evaluated voxel. This is a lower
# bound: a differently predicted voxel leaves one cell and enters another.


EQUAL_CONTENT, NEAR_EQUAL, NEAR_EQUAL_TEAMS = "equal_content", "near_equal", "near_equal_teams"
IMPOSSIBLE_COUNTS = "impossible_counts"
LATE_AS_GOOD = "late_as_good"
LATE_RATIOS = ("iou_occ", "miou")
DAY_NS = 86_400 * 10**9

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class AlarmLimits:
    """Limits of the alarms.

    A team is probing if `near_entries` of its entries within `window_ns` are each nearer than `near_ratio` to another
    entry. The search covers the last `looked_at` entries of the team and of all other teams.

    If at least `late_voxels` late voxels (`stone.labels.late_voxels`) are occupied, the alarm compares IoU_occ and mIoU
    in late voxels with their values elsewhere. It requires at least `late_least`, and at least `late_margin` times the
    value elsewhere. Over the demo's hidden worlds the baselines, and an entry that guesses ahead, score below 0.03 in
    late voxels. The platform's own labelling scores above 0.97.
    """

    near_ratio: float = 1e-4
    near_entries: int = 5
    window_ns: int = DAY_NS
    looked_at: int = 64
    late_voxels: int = 5_000
    late_least: float = 0.25
    late_margin: float = 0.75


@dataclass(frozen=True, eq=False)
class ScoredEntry:
    """A scored entry with its counts by sequence, ring and cell in one row (k)."""

    submission_id: str
    team_id: str
    team: str
    method: str
    finalized_ns: int
    content_sha256: str
    cells: Cells

    def facts(self) -> dict[str, Any]:
        return {"submission_id": self.submission_id, "team_id": self.team_id, "team": self.team, "method": self.method}


@dataclass(frozen=True)
class AlarmCandidate:
    """An alarm to raise, unless an alarm of this kind about this subject exists."""

    kind: str
    subject: str
    facts: Mapping[str, Any]


def flat_cells(cells: Mapping[str, Any]) -> Cells:
    """Return the counts of all sequences (k), in the order of their names."""
    return np.asarray([cells[name] for name in sorted(cells)], np.int64).reshape(-1)


def differing_ratio(entry: Cells, others: Cells) -> NDArray[np.float64]:
    """Return a lower bound of the share of voxels in which `one` (k) and each row of `others` (n, k) differ.

    The bound is 1 if there are no voxels.
    """
    moved = np.abs(others - entry).sum(axis=1) / 2
    voxels = int(entry.sum())
    return np.asarray(moved / voxels if voxels else np.ones(len(others)), np.float64)


def suspicions(
    mine: ScoredEntry, own: Sequence[ScoredEntry], foreign: Sequence[ScoredEntry], limits: AlarmLimits
) -> list[AlarmCandidate]:
    """Return the alarms about `mine`, given other entries of its team and entries of other teams."""
    equal = [(entry, 0.0) for entry in foreign if entry.content_sha256 == mine.content_sha256]
    return [
        *_about_the_later(EQUAL_CONTENT, mine, equal),
        *_about_the_later(NEAR_EQUAL_TEAMS, mine, _near(mine, foreign, limits)),
        *_probing([mine, *own], limits),
    ]


def late_suspicion(mine: ScoredEntry, late: Mapping[str, Any] | None, limits: AlarmLimits) -> list[AlarmCandidate]:
    """Return the alarm about `mine` if it is as good in late voxels as elsewhere; `late` is that part of its record."""
    if late is None or sum(late["support"].values()) - late["support"]["free"] < limits.late_voxels:
        return []
    pairs = {name: (late["ratios"][name], late["elsewhere"][name]) for name in LATE_RATIOS}
    known = [(there, other) for there, other in pairs.values() if there is not None and other is not None]
    if not known or any(there < max(limits.late_least, limits.late_margin * other) for there, other in known):
        return []
    return [AlarmCandidate(LATE_AS_GOOD, mine.submission_id, {**mine.facts(), "late": dict(late)})]


def _near(mine: ScoredEntry, foreign: Sequence[ScoredEntry], limits: AlarmLimits) -> list[tuple[ScoredEntry, float]]:
    """Return the entries that are near but not equal, with the share of voxels in which they differ."""
    unequal = [entry for entry in foreign if entry.content_sha256 != mine.content_sha256]
    if not unequal:
        return []
    differing = differing_ratio(mine.cells, np.stack([entry.cells for entry in unequal])).tolist()
    return [(entry, by) for entry, by in zip(unequal, differing, strict=True) if by < limits.near_ratio]


def _about_the_later(
    kind: str, mine: ScoredEntry, others: Sequence[tuple[ScoredEntry, float]]
) -> Iterator[AlarmCandidate]:
    """Yield one alarm about `mine` if there are earlier entries, and one alarm about each later entry."""
    earlier = [
        {**entry.facts(), "differing_ratio": by} for entry, by in others if entry.submission_id < mine.submission_id
    ]
    if earlier:
        yield AlarmCandidate(kind, mine.submission_id, {**mine.facts(), "others": earlier})
    for entry, by in others:
        if entry.submission_id > mine.submission_id:
            seen = {**mine.facts(), "differing_ratio": by}
            yield AlarmCandidate(kind, entry.submission_id, {**entry.facts(), "others": [seen]})


def _probing(entries: Sequence[ScoredEntry], limits: AlarmLimits) -> Iterator[AlarmCandidate]:
    """Yield an alarm about the team's day if a window that contains the first entry is full of near entries."""
    mine, cells = entries[0], np.stack([entry.cells for entry in entries])
    ends_ns = np.array([entry.finalized_ns for entry in entries], np.int64)
    near = np.stack([differing_ratio(row, cells) < limits.near_ratio for row in cells])
    np.fill_diagonal(near, False)
    for end_ns in sorted({int(end) for end in ends_ns if 0 <= end - mine.finalized_ns < limits.window_ns}):
        inside = (ends_ns > end_ns - limits.window_ns) & (ends_ns <= end_ns)
        is_probe = inside & (near & inside).any(axis=1)
        if is_probe.sum() >= limits.near_entries:
            probes = [entry.facts() for entry, is_one in zip(entries, is_probe.tolist(), strict=True) if is_one]
            facts = {"team_id": mine.team_id, "team": mine.team, "entries": probes}
            yield AlarmCandidate(NEAR_EQUAL, f"{mine.team_id}:{end_ns // DAY_NS}", facts)
            return


DEFAULTS = AlarmLimits()
LOCK = 0x414C524D  # "ALRM": first half of the advisory lock's key; the phase is the second half


def raise_alarms(session: Session, score: Score, limits: AlarmLimits = DEFAULTS) -> None:
    """Raise the alarms that follow from `score`, a row of this transaction; call it near the end of the join.

    If two joins run at once, the second waits in this function for the first one's commit.
    """
    session.flush()
    own = session.get_one(SubmissionRow, score.submission_id)
    phase = session.get_one(Phase, own.phase_id)
    if not is_charged(phase, own.kind):
        return
    _take_turns(session, own.phase_id)
    if _is_known(session, score):
        return
    entries = _entries(score, ON_BOARDS if phase.is_hidden else ("entry",))
    mine = _load_scored(session, entries.where(SubmissionRow.id == own.id), 1)[0]
    seen = _load_entries(session, entries, score, own.team_id, limits)
    others = [entry for entry in seen if entry.submission_id != own.id]
    of_team = [entry for entry in others if entry.team_id == own.team_id]
    foreign = [entry for entry in others if entry.team_id != own.team_id]
    raised = {"phase_id": own.phase_id, "created_ns": now_ns()}
    about = suspicions(mine, of_team, foreign, limits)
    if phase.is_hidden:
        about += late_suspicion(mine, score.record.get("late"), limits)
    insert_new(session, Alarm, [{"id": new_id(), **raised, **vars(entry)} for entry in about])


def raise_impossible_counts(session: Session, submission: SubmissionRow) -> None:
    """Raise an alarm: counting a sound file stopped or returned impossible counts. The file may be an attack."""
    team = session.get_one(Team, submission.team_id)
    facts = {"submission_id": submission.id, "team_id": team.id, "team": team.name, "method": submission.method}
    about = {"kind": IMPOSSIBLE_COUNTS, "subject": submission.id, "facts": facts}
    insert_new(session, Alarm, [{"id": new_id(), "phase_id": submission.phase_id, "created_ns": now_ns(), **about}])


def open_alarms(phase_id: str) -> Select[Alarm]:
    """Select the alarms of a phase that were not dismissed."""
    return select(Alarm).where(Alarm.phase_id == phase_id, Alarm.dismissed_ns.is_(None))


def dismiss(session: Session, alarm_id: str) -> Alarm:
    """Dismiss an alarm for good. Raises `alarm_missing`, `AlarmDismissedError`."""
    alarm = session.get(Alarm, alarm_id, with_for_update={"key_share": True}, populate_existing=True)
    if alarm is None:
        raise Refused("alarm_missing", f"there is no alarm {alarm_id[:80]!r}")
    if alarm.dismissed_ns is not None:
        raise AlarmDismissedError(alarm_id)
    alarm.dismissed_ns = now_ns()
    return alarm


def _take_turns(session: Session, phase_id: str) -> None:
    """Take the lock that serialises alarm creation in a phase; on SQLite the transaction is the lock."""
    if session.get_bind().dialect.name == "postgresql":
        phase = int(phase_id[-7:], 16)
        session.execute(text("SELECT pg_advisory_xact_lock(:lock, :phase)"), {"lock": LOCK, "phase": phase})


def _is_known(session: Session, score: Score) -> bool:
    """Return whether the same counts were already checked, with another metric."""
    same = select(Score.id).where(Score.submission_id == score.submission_id, Score.truth_id == score.truth_id)
    return session.scalar(same.where(Score.id != score.id).limit(1)) is not None


def _entries(score: Score, kinds: tuple[str, ...]) -> Select[Any]:
    """Select submissions of these kinds with a score against this ground truth, one row each, newest first."""
    other = aliased(Score)
    first = (
        select(other.id)
        .where(other.submission_id == SubmissionRow.id, other.truth_id == score.truth_id)
        .order_by(other.id)
        .limit(1)
        .scalar_subquery()
    )
    columns = (SubmissionRow.id, SubmissionRow.team_id, Team.name, SubmissionRow.method, SubmissionRow.finalized_ns)
    return (
        select(*columns, Score.content_sha256, Score.record["cells"])
        .join(Score, Score.submission_id == SubmissionRow.id)
        .join(Team, Team.id == SubmissionRow.team_id)
        .where(Score.id == first, SubmissionRow.kind.in_(kinds))
        .order_by(SubmissionRow.id.desc())
    )


def _load_entries(
    session: Session, entries: Select[Any], score: Score, team_id: str, limits: AlarmLimits
) -> list[ScoredEntry]:
    """Return the last entries of the team and of others, and all others with equal content, without duplicates."""
    foreign = SubmissionRow.team_id != team_id
    queries = (
        entries.where(SubmissionRow.team_id == team_id),
        entries.where(foreign),
        entries.where(foreign, Score.content_sha256 == score.content_sha256),
    )
    entries_seen = [entry for query in queries for entry in _load_scored(session, query, limits.looked_at)]
    return list({entry.submission_id: entry for entry in entries_seen}.values())


def _load_scored(session: Session, query: Select[Any], most: int) -> list[ScoredEntry]:
    return [
        ScoredEntry(row[0], row[1], row[2], row[3], row[4] or 0, row[5], flat_cells(row[6]))
        for row in session.execute(query.limit(most))
    ]
