"""A board as a benchmark has it after a season: entries that tie, a baseline, reported rows, a row without a rank.

**Conventions.** Records and draws are true ones of counts that a test makes up (`boards.py`); times are days ago, so
that the board has a history. `mine` is of the team of `member`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from services.domain.benchmarks.phases.reported_results import ReportedRow, put_reported
from services.runtime.orm import Benchmark, Phase, TeamMember
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from testing.api.serving import Person, person
from tests.services.domain.benchmarks.boards import Made, Scene, scene

DAY_NS = 86_400 * 10**9
DESCRIPTION = (
    "Sparse convolutions over the sweep, lifted features of six cameras.\n\nTrained on train only.\n<b>bold</b>"
)
ENTRIES = (
    ("TerrainFormer-L", "C+L", "Hanyang Robotics", Made(0.24, 1), 4),
    ("GroundNet++", "C+L", "Terrain Gang", Made(0.25, 2), 12),
    ("VoxTrav", "L", "Off-road Lab", Made(0.25, 8), 21),
    ("SurroundOcc-T", "C", "Camera Only Club", Made(0.42, 4), 26),
    ("RadarScout", "R", "Mist & Dust", Made(0.61, 5), 29),
)
REPORTED = (
    ReportedRow("OccFormer", "C", "made up for a test, Table II", 0.41, 0.31, 0.20, 0.22, 0.243,
                "published on another split; not comparable with a score on other data", percent_digits=1),
    ReportedRow("CONet", "C+L", "made up for a test, Table II", 0.62, 0.55, 0.47, 0.50, 0.507),
    ReportedRow("Ceiling by sweeps: val", "L", "stone ceiling --by sweeps", 0.751, 0.812, 0.764, 0.767, 0.781,
                "labels from even sweeps, scored against labels from odd sweeps", percent_digits=1, kind="ceiling"),
)  # fmt: skip


@dataclass(frozen=True)
class Season:
    """`entries` are the ids of the submissions by method."""

    at: Scene
    member: Person
    benchmark: str
    entries: dict[str, str]

    @property
    def path(self) -> str:
        return f"/benchmarks/{self.benchmark}/val"

    @property
    def mine(self) -> str:
        return self.entries["GroundNet++"]


def publish(at: Scene, reported: Sequence[ReportedRow] = ()) -> str:
    """The name of the scene's benchmark, which from now on anybody may look at."""
    with at.platform.database.transaction() as session:
        phase = session.get_one(Phase, at.phase_id)
        phase.title, phase.opens_ns, phase.closes_ns = "Validation", now_ns() - 35 * DAY_NS, now_ns() + 40 * DAY_NS
        benchmark = session.get_one(Benchmark, phase.benchmark_id)
        benchmark.is_public, benchmark.title = True, "STONE"
        benchmark.description = "3D traversability around the robot, from one sweep and six cameras."
        put_reported(session, phase, reported)
        return benchmark.name


def season(platform: Platform) -> Season:
    """A public benchmark whose open phase has a board."""
    at = scene(platform)
    name = publish(at, REPORTED)
    member = person(platform, "participant")
    entries = {method: _entered(at, modality, team, method, made, days, member)
               for method, modality, team, made, days in ENTRIES}  # fmt: skip
    kinds = {"kind": "baseline", "modality": "L"}
    entries["Nearest class"] = at.enter(
        at.team("Organisers"), Made(0.5, 8), method="Nearest class", **kinds, **_days(30)
    )
    entries["NoPotential"] = at.enter(at.team("Half Done"), Made(0.3, 9, 2), method="NoPotential", **_days(9))
    return Season(at, member, name, entries)


def _entered(at: Scene, modality: str, team: str, method: str, made: Made, days: int, member: Person) -> str:
    team_id = at.team(team)
    if team == "Terrain Gang":
        with at.platform.database.transaction() as session:
            session.add(TeamMember(team_id=team_id, user_id=member.user_id, is_owner=True))
        at.enter(team_id, Made(0.34, 7), method="GroundNet", modality="C+L", **_days(24))
    return at.enter(team_id, made, method=method, modality=modality, description=DESCRIPTION, **_days(days))


def _days(ago: int) -> dict[str, int]:
    at_ns = now_ns() - ago * DAY_NS
    return {"finalized_ns": at_ns, "settled_ns": at_ns, "created_ns": at_ns}
