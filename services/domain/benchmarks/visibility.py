"""The visibility policy of submissions: one table of who may see what, applied by the queries.

**Conventions.** A viewer's relation to a submission is administrator, member of its team, or other. A phase's ground
truth is open, or hidden until the phase ends, or hidden after its end. A field that may not be seen is null; routes
never decide this. Ratios that may be seen only rounded have `RATIO_DIGITS` digits. Boards are ordered by rounded ratios
for every viewer, so ranks reveal no more than the values.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from sqlalchemy import ColumnElement, Select, and_, or_, select, true
from sqlalchemy.orm import Session

from services.runtime.database.rows import KeptSelect, parameter
from services.runtime.orm import Benchmark, Phase, SubmissionRow, TeamMember

Relation = Literal["administrator", "member", "other"]
Secrecy = Literal["open", "running", "ended"]
Field = Literal[
    "totals", "exact", "intervals", "ranks", "comparison", "breakdowns", "extras", "confusions", "content",
    "provenance", "method", "description", "team", "file", "state", "problems", "reason", "frames", "predictions",
    "baseline",
]  # fmt: skip

RATIO_DIGITS = 4
PERCENT_DIGITS = RATIO_DIGITS - 2
ON_BOARDS = ("entry", "baseline")

_ADMINISTRATOR: tuple[Relation, ...] = ("administrator",)
_TEAM: tuple[Relation, ...] = ("administrator", "member")
_ALL: tuple[Relation, ...] = ("administrator", "member", "other")
# Viewers of each field while the ground truth is open, hidden in a running phase, hidden in an ended phase.
TABLE: Mapping[Field, Mapping[Secrecy, tuple[Relation, ...]]] = {
    "totals": {"open": _ALL, "running": _ALL, "ended": _ALL},  # rounded
    "exact": {"open": _ALL, "running": _ADMINISTRATOR, "ended": _ALL},
    "intervals": {"open": _ALL, "running": _ADMINISTRATOR, "ended": _ALL},
    "ranks": {"open": _ALL, "running": _ALL, "ended": _ALL},  # rank interval and tie group
    "comparison": {"open": _ALL, "running": _ADMINISTRATOR, "ended": _ALL},  # except the difference of rounded totals
    "breakdowns": {"open": _ALL, "running": _ADMINISTRATOR, "ended": _ALL},
    "extras": {"open": _ALL, "running": _ADMINISTRATOR, "ended": _ALL},  # supports and the total confusion too
    # Counts by frame come close to the labels themselves, which another phase may hide.
    "confusions": {"open": _TEAM, "running": _ADMINISTRATOR, "ended": _ADMINISTRATOR},
    "content": {"open": _TEAM, "running": _ADMINISTRATOR, "ended": _ADMINISTRATOR},
    "provenance": {"open": _ALL, "running": _ALL, "ended": _ALL},
    "method": {"open": _ALL, "running": _ALL, "ended": _ALL},
    "description": {"open": _ALL, "running": _ALL, "ended": _ALL},  # from `named_from_ns`
    "team": {"open": _ALL, "running": _ALL, "ended": _ALL},  # from `named_from_ns`
    "file": {"open": _TEAM, "running": _TEAM, "ended": _TEAM},
    "state": {"open": _TEAM, "running": _TEAM, "ended": _TEAM},
    "problems": {"open": _TEAM, "running": _TEAM, "ended": _TEAM},
    "reason": {"open": _TEAM, "running": _TEAM, "ended": _TEAM},  # why an entry was hidden
    # Pictures of predictions beside the labels; hidden labels are never shown, in any phase.
    "frames": {"open": _ALL, "running": (), "ended": ()},
    "predictions": {"open": _TEAM, "running": _TEAM, "ended": _TEAM},  # the zip of an entry
    # The zip of a baseline may contain hidden labels that their owner submitted.
    "baseline": {"open": _ALL, "running": _TEAM, "ended": _TEAM},
}
NAMING: tuple[Field, ...] = ("team", "description")


@dataclass(frozen=True)
class Viewer:
    """A viewer: an administrator, a user with teams, or a visitor, who sees only public benchmarks."""

    is_administrator: bool = False
    team_ids: frozenset[str] = frozenset()
    is_visitor: bool = False

    def relation(self, team_id: str) -> Relation:
        if self.is_administrator:
            return "administrator"
        return "member" if team_id in self.team_ids else "other"


ANYBODY = Viewer()
_TEAMS = KeptSelect(select(TeamMember.team_id).where(TeamMember.user_id == parameter("user")))


@dataclass(frozen=True)
class Policy:
    """The parts of one submission that one viewer may currently see."""

    relation: Relation
    secrecy: Secrecy
    is_named: bool

    def shows(self, field: Field) -> bool:
        if field in NAMING and not self.is_named and self.relation == "other":
            return False
        return self.relation in TABLE[field][self.secrecy]

    def ratio(self, value: float | None) -> float | None:
        """Return a total as the viewer may see it: exact or rounded."""
        return value if value is None or self.shows("exact") else rounded(value)


def rounded(value: float) -> float:
    """Return the ratio rounded to the digits by which boards are shown and ordered."""
    return round(value, RATIO_DIGITS)


def viewer_of(session: Session, user_id: str, is_administrator: bool) -> Viewer:
    """Return the user as a viewer; set `is_administrator` only if role and scope allow acting as one."""
    teams = _TEAMS.rows(session, {"user": user_id})
    return Viewer(is_administrator, frozenset(row.team_id for row in teams))


def secrecy_of(phase: Phase, now_ns: int) -> Secrecy:
    """Return the state of the ground truth's secrecy; a hidden phase without an end stays "running"."""
    if not phase.is_hidden:
        return "open"
    return "ended" if phase.closes_ns is not None and phase.closes_ns <= now_ns else "running"


def policy_of(viewer: Viewer, phase: Phase, team_id: str, now_ns: int) -> Policy:
    """Return the viewer's policy for a submission of this team in this phase."""
    is_named = phase.named_from_ns is None or phase.named_from_ns <= now_ns
    return Policy(viewer.relation(team_id), secrecy_of(phase, now_ns), is_named)


def submissions_seen(viewer: Viewer) -> Select[SubmissionRow]:
    """Select the submissions visible to the viewer: all, or their teams' submissions and those on a board."""
    return select(SubmissionRow).where(_is_seen(viewer))


def is_on_board() -> ColumnElement[bool]:
    """Return the condition that a submission is scored, of a shown kind, and neither withdrawn nor hidden."""
    return and_(
        SubmissionRow.state == "scored",
        SubmissionRow.kind.in_(ON_BOARDS),
        SubmissionRow.withdrawn_ns.is_(None),
        SubmissionRow.hidden_ns.is_(None),
    )


def _is_seen(viewer: Viewer) -> ColumnElement[bool]:
    if viewer.is_administrator:
        return true()
    if viewer.is_visitor:
        is_public = select(Phase.id).join(Benchmark, Benchmark.id == Phase.benchmark_id).where(Benchmark.is_public)
        return and_(is_on_board(), SubmissionRow.phase_id.in_(is_public))
    return or_(is_on_board(), SubmissionRow.team_id.in_(sorted(viewer.team_ids)))


# The visibility policy of a phase in sentences, generated from `TABLE`, so that sentences and queries agree.


WORDS: dict[Field, str] = {
    "totals": f"totals rounded to {RATIO_DIGITS} digits",
    "exact": "exact totals",
    "intervals": "intervals",
    "ranks": "intervals of ranks and ties",
    "comparison": "paired comparisons",
    "breakdowns": "results by sequence, environment, illumination and distance",
    "extras": "additional metrics and supports",
    "confusions": "confusion counts per frame",
    "content": "equality of predictions",
    "provenance": "provenance of scores",
    "method": "methods and modalities",
    "description": "method descriptions",
    "team": "teams",
    "file": "size and sha256 of files",
    "state": "progress of submissions",
    "problems": "problems of files",
    "reason": "reasons for hiding entries",
    "frames": "pictures of frames beside the ground truth",
    "predictions": "zips of entries",
    "baseline": "zips of baselines",
}
VIEWERS: dict[tuple[Relation, ...], str] = {
    ("administrator", "member", "other"): "everyone",
    ("administrator", "member"): "the team and administrators",
    ("administrator",): "administrators only",
    (): "nobody",
}
WHEN: dict[Secrecy, str] = {
    "open": "The ground truth is open",
    "running": "The ground truth is hidden and the phase has not ended",
    "ended": "The ground truth is hidden and the phase has ended",
}


def policy_sentences(phase: Phase, at_ns: int) -> tuple[str, ...]:
    """Return the current policy in sentences, and for a hidden phase with an end also the later policy."""
    now = secrecy_of(phase, at_ns)
    later: tuple[Secrecy, ...] = ("ended",) if now == "running" and phase.closes_ns is not None else ()
    named = phase.named_from_ns is not None and at_ns < phase.named_from_ns
    hidden_names = ("Until named_from_at, only members and administrators see teams and method descriptions.",)
    return (*(_sentence(state) for state in (now, *later)), *(hidden_names if named else ()))


def _sentence(state: Secrecy) -> str:
    return f"{WHEN[state]}: {'; '.join(_shares(state))}."


def _shares(state: Secrecy) -> Iterator[str]:
    for viewers, words in VIEWERS.items():
        seen = [WORDS[name] for name, table in TABLE.items() if table[state] == viewers]
        if seen:
            yield f"{words}: {', '.join(seen)}"
