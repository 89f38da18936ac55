"""Names of phases and teams that rows mention by id."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from sqlalchemy import select
from sqlalchemy.orm import Session

from services.runtime.orm import Benchmark, Phase, Team


@dataclass(frozen=True)
class PhaseName:
    """The name of a phase, and the URL of its pages."""

    benchmark: str
    title: str
    phase: str

    @property
    def path(self) -> str:
        return f"/benchmarks/{self.benchmark}/{self.phase}"

    @property
    def said(self) -> str:
        return f"{self.title or self.benchmark} · {self.phase}"


def phase_names(session: Session, ids: Iterable[str]) -> Mapping[str, PhaseName]:
    """Phase names by the phase's id; one statement."""
    joined = select(Phase.id, Benchmark.name, Benchmark.title, Phase.name).join(
        Benchmark, Benchmark.id == Phase.benchmark_id
    )
    found = session.execute(joined.where(Phase.id.in_(set(ids))))
    return {phase_id: PhaseName(benchmark, title, phase) for phase_id, benchmark, title, phase in found}


def team_names(session: Session, ids: Iterable[str]) -> Mapping[str, str]:
    """Team names by the team's id; one statement."""
    named = select(Team.id, Team.name).where(Team.id.in_(set(ids)))
    return {team_id: name for team_id, name in session.execute(named)}
