"""Similarity of scored entries by their confusion counts, and the alarms that follow.

**Conventions.** Two submissions of one ground truth differ by at least half of what their counts by sequence, ring and
cell differ, as a share of all evaluated voxels: a voxel predicted otherwise leaves one cell and enters another. So what
is told as near may in truth be farther apart, but never the other way round.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

EQUAL_CONTENT, NEAR_EQUAL, NEAR_EQUAL_TEAMS = "equal_content", "near_equal", "near_equal_teams"
DAY_NS = 86_400 * 10**9

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class AlarmLimits:
    """`near_entries` of a team within `window_ns`, each nearer than `near_ratio` to another of them, is probing.

    Of the team and of all others, the last `looked_at` entries are looked at.
    """

    near_ratio: float = 1e-4
    near_entries: int = 5
    window_ns: int = DAY_NS
    looked_at: int = 64


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
    """An alarm to be raised, unless there is one of this kind about this subject."""

    kind: str
    subject: str
    facts: Mapping[str, Any]


def flat_cells(cells: Mapping[str, Any]) -> Cells:
    """The counts of all sequences (k), in the order of their names."""
    return np.asarray([cells[name] for name in sorted(cells)], np.int64).reshape(-1)


def differing_ratio(one: Cells, others: Cells) -> NDArray[np.float64]:
    """The least share of voxels in which `one` (k) differs from each row of `others` (n, k); ones for no voxels."""
    moved = np.abs(others - one).sum(axis=1) / 2
    voxels = int(one.sum())
    return np.asarray(moved / voxels if voxels else np.ones(len(others)), np.float64)


def suspicions(
    mine: ScoredEntry, own: Sequence[ScoredEntry], foreign: Sequence[ScoredEntry], limits: AlarmLimits
) -> list[AlarmCandidate]:
    """The alarms about `mine`, beside other entries of its team and those of other teams."""
    equal = [(one, 0.0) for one in foreign if one.content_sha256 == mine.content_sha256]
    return [
        *_about_the_later(EQUAL_CONTENT, mine, equal),
        *_about_the_later(NEAR_EQUAL_TEAMS, mine, _near(mine, foreign, limits)),
        *_probing([mine, *own], limits),
    ]


def _near(mine: ScoredEntry, foreign: Sequence[ScoredEntry], limits: AlarmLimits) -> list[tuple[ScoredEntry, float]]:
    """Entries that are near without being equal, with the share in which they differ."""
    unequal = [one for one in foreign if one.content_sha256 != mine.content_sha256]
    if not unequal:
        return []
    differing = differing_ratio(mine.cells, np.stack([one.cells for one in unequal])).tolist()
    return [(one, by) for one, by in zip(unequal, differing, strict=True) if by < limits.near_ratio]


def _about_the_later(
    kind: str, mine: ScoredEntry, others: Sequence[tuple[ScoredEntry, float]]
) -> Iterator[AlarmCandidate]:
    """One about `mine` when there are earlier ones, and one about each later one."""
    earlier = [{**one.facts(), "differing_ratio": by} for one, by in others if one.submission_id < mine.submission_id]
    if earlier:
        yield AlarmCandidate(kind, mine.submission_id, {**mine.facts(), "others": earlier})
    for one, by in others:
        if one.submission_id > mine.submission_id:
            seen = {**mine.facts(), "differing_ratio": by}
            yield AlarmCandidate(kind, one.submission_id, {**one.facts(), "others": [seen]})


def _probing(entries: Sequence[ScoredEntry], limits: AlarmLimits) -> Iterator[AlarmCandidate]:
    """About the team's day: a window that holds the first entry and ends with any is full of near ones."""
    mine, cells = entries[0], np.stack([one.cells for one in entries])
    ends_ns = np.array([one.finalized_ns for one in entries], np.int64)
    near = np.stack([differing_ratio(row, cells) < limits.near_ratio for row in cells])
    np.fill_diagonal(near, False)
    for end_ns in sorted({int(end) for end in ends_ns if 0 <= end - mine.finalized_ns < limits.window_ns}):
        inside = (ends_ns > end_ns - limits.window_ns) & (ends_ns <= end_ns)
        is_probe = inside & (near & inside).any(axis=1)
        if is_probe.sum() >= limits.near_entries:
            probes = [one.facts() for one, is_one in zip(entries, is_probe.tolist(), strict=True) if is_one]
            facts = {"team_id": mine.team_id, "team": mine.team, "entries": probes}
            yield AlarmCandidate(NEAR_EQUAL, f"{mine.team_id}:{end_ns // DAY_NS}", facts)
            return
