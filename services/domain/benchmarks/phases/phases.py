"""Benchmarks and their phases: created from a dataset version, found by name, changed only where entries allow it.

**Conventions.** A phase is open in [opens_ns, closes_ns); null is no limit. Version, part, mask and secrecy of the
ground truth are fixed once the phase has a ground truth that is ready or under construction. A phase over test is
always hidden, and its `every_nth` never changes. Changing a phase locks its row.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from secrets import token_hex
from typing import Any, Literal

from sqlalchemy import select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from services.runtime.access.errors import name_taken
from services.runtime.jobs.specs import TERMINAL
from services.runtime.orm import Benchmark, Dataset, DatasetMember, GroundTruthRow, Job, Phase, SubmissionRow
from services.runtime.orm.base import now_ns
from stone.errors import Refused

PhaseStatus = Literal["upcoming", "open", "closed"]
Mask = Literal["all", "lidar", "camera"]
Part = Literal["train", "val", "test"]

HIDDEN_PART: Part = "test"
DAY_NS = 86_400 * 10**9
MOST_SCORINGS = 1_000_000
MOST_MEMBERS = 100
MOST_APART = 1000
LONGEST_WINDOW_NS = 366 * DAY_NS
FIXED = ("dataset_id", "part", "mask", "is_hidden")
COUNTED = {
    "scorings_per_window": (0, MOST_SCORINGS),
    "scorings_total": (0, MOST_SCORINGS),
    "validations_per_day": (0, MOST_SCORINGS),
    "team_members": (1, MOST_MEMBERS),
    "every_nth": (1, MOST_APART),
    "window_ns": (10**9, LONGEST_WINDOW_NS),
}


@dataclass(frozen=True)
class NewBenchmark:
    """A benchmark to create; `name` is used in URLs, the other fields are plain text."""

    name: str
    title: str
    description: str
    user_id: str


@dataclass(frozen=True)
class Rules:
    """Opening times and quotas: the columns of `Phase`."""

    title: str = ""
    opens_ns: int | None = None
    closes_ns: int | None = None
    named_from_ns: int | None = None
    scorings_per_window: int | None = None
    window_ns: int = 7 * DAY_NS
    scorings_total: int | None = None
    validations_per_day: int = 20
    team_members: int = 10


@dataclass(frozen=True)
class NewPhase:
    """A phase to create."""

    name: str
    part: Part
    is_hidden: bool
    mask: Mask = "all"
    rules: Rules = field(default_factory=Rules)
    every_nth: int | None = None


VAL = NewPhase("val", "val", False, rules=Rules("Validation: open ground truth, unlimited submissions"))
TEST = NewPhase("test", "test", True, rules=Rules("Test: hidden ground truth", scorings_per_window=3))
DEFAULTS = (VAL, TEST)


def create_benchmark(session: Session, new: NewBenchmark) -> Benchmark:
    """Create a benchmark. Raises `name_taken`."""
    if session.scalar(select(Benchmark.id).where(Benchmark.name == new.name)) is not None:
        raise name_taken("benchmark", new.name)
    row = Benchmark(name=new.name, title=new.title, description=new.description, created_by=new.user_id)
    _insert(session, row, "benchmark")
    return row


def change_benchmark_columns(session: Session, benchmark: Benchmark, changes: Mapping[str, Any]) -> None:
    """Change the texts of a benchmark, or whether it is public."""
    for name, value in changes.items():
        setattr(benchmark, name, value)
    session.flush()


def default_phases(session: Session, dataset: Dataset) -> tuple[NewPhase, ...]:
    """Return `val` (open) and `test` (hidden) as far as the version has them. Raises `empty_part` without any."""
    parts = set(session.scalars(select(DatasetMember.part).where(DatasetMember.dataset_id == dataset.id).distinct()))
    phases = tuple(phase for phase in DEFAULTS if phase.part in parts)
    if not phases:
        raise empty_part(dataset.name, "val or test")
    return phases


def create_phase(session: Session, benchmark: Benchmark, dataset: Dataset, new: NewPhase) -> Phase:
    """Create a phase. Raises `name_taken`, `empty_part`, `open_test`, `bad_phase`."""
    if phase_named(session, benchmark.name, new.name) is not None:
        raise name_taken("phase", new.name)
    row = Phase(benchmark_id=benchmark.id, dataset_id=dataset.id, name=new.name)
    row.part, row.mask, row.is_hidden, row.every_nth = new.part, new.mask, new.is_hidden, new.every_nth
    row.token_key = None if new.every_nth is None else token_hex(32)
    for name, value in vars(new.rules).items():
        setattr(row, name, value)
    refuse_contradictions(session, row, dataset)
    _insert(session, row, "phase")
    return row


def change_phase(session: Session, phase_id: str, changes: Mapping[str, Any]) -> Phase:
    """Change columns of the phase and increment its revision; `lock_phase` locks the row before the ETag is compared.

    Raises `phase_fixed`, `phase_ended`, `empty_part`, `open_test`, `bad_phase`.
    """
    phase = lock_phase(session, phase_id)
    changed = {name: value for name, value in changes.items() if getattr(phase, name) != value}
    fixed = sorted(set(changed) & set(FIXED))
    if fixed and has_truth(session, phase.id):
        raise Refused(
            "phase_fixed",
            f"phase {phase.name!r} has a ground truth, so {', '.join(name.removesuffix('_id') for name in fixed)} "
            "cannot change; add another phase instead",
        )
    if "closes_ns" in changed and _has_public_results(session, phase):
        raise Refused(
            "phase_ended",
            f"hidden phase {phase.name!r} has ended and its results by sequence are already visible; add another "
            "phase instead",
        )
    for name, value in changed.items():
        setattr(phase, name, value)
    refuse_contradictions(session, phase, session.get_one(Dataset, phase.dataset_id))
    phase.revision += 1
    session.flush()
    return phase


def lock_phase(session: Session, phase_id: str) -> Phase:
    """Return the current phase, with its row locked until the end of the transaction."""
    locked = select(Phase).where(Phase.id == phase_id).with_for_update(key_share=True)
    return session.scalars(locked.execution_options(populate_existing=True)).one()


def phase_named(session: Session, benchmark: str, phase: str) -> Phase | None:
    """Return the phase with these names, or None."""
    joined = select(Phase).join(Benchmark, Benchmark.id == Phase.benchmark_id)
    return session.scalars(joined.where(Benchmark.name == benchmark, Phase.name == phase)).one_or_none()


def phase_status(phase: Phase, at_ns: int) -> PhaseStatus:
    """Return whether the phase accepts submissions at this time, opens later, or is closed."""
    if phase.closes_ns is not None and at_ns >= phase.closes_ns:
        return "closed"
    return "upcoming" if phase.opens_ns is not None and at_ns < phase.opens_ns else "open"


def has_truth(session: Session, phase_id: str) -> bool:
    """Return whether the phase has a ground truth that is ready or under construction."""
    of_phase = (
        select(GroundTruthRow.id)
        .outerjoin(Job, Job.id == GroundTruthRow.job_id)
        .where(GroundTruthRow.phase_id == phase_id)
    )
    standing = of_phase.where(GroundTruthRow.ready_ns.is_not(None) | Job.state.not_in(TERMINAL))
    return session.scalar(standing.limit(1)) is not None


def refuse_contradictions(session: Session, phase: Phase, dataset: Dataset) -> None:
    """Raise `open_test`, `empty_part` or `bad_phase` if the phase's columns contradict each other."""
    if phase.part == HIDDEN_PART and not phase.is_hidden:
        raise Refused(
            "open_test",
            f"the labels of {phase.part} are hidden, and an open phase would reveal exact results; make the phase "
            "hidden",
        )
    refuse_empty(session, dataset, phase.part)
    if phase.every_nth is not None and not phase.is_hidden:
        raise Refused(
            "bad_phase",
            f"every_nth is {phase.every_nth}, but an open phase reveals its frames; hide the phase, or omit every_nth",
        )
    for name, (least, most) in COUNTED.items():
        value = getattr(phase, name)
        if value is not None and not least <= value <= most:
            raise Refused("bad_phase", f"{name} is {str(value)[:80]!r}; expected {least} to {most}")
    if phase.opens_ns is not None and phase.closes_ns is not None and phase.opens_ns >= phase.closes_ns:
        raise Refused(
            "bad_phase", f"closes_ns is {str(phase.closes_ns)[:80]!r}; expected a time after opens_ns {phase.opens_ns}"
        )


def refuse_empty(session: Session, dataset: Dataset, part: str) -> None:
    """Raise `empty_part` if the version has no sequence in the part."""
    in_part = select(DatasetMember.sequence_id).where(
        DatasetMember.dataset_id == dataset.id, DatasetMember.part == part
    )
    if session.scalar(in_part.limit(1)) is None:
        raise empty_part(dataset.name, part)


def _has_public_results(session: Session, phase: Phase) -> bool:
    """Return whether the phase is hidden, has ended, and has a scored submission."""
    if not phase.is_hidden or phase_status(phase, now_ns()) != "closed":
        return False
    scored = select(SubmissionRow.id).where(SubmissionRow.phase_id == phase.id, SubmissionRow.state == "scored")
    return session.scalar(scored.limit(1)) is not None


def _insert(session: Session, row: Benchmark | Phase, kind: str) -> None:
    session.add(row)
    try:
        session.flush()
    except IntegrityError:  # a concurrent transaction took the name
        raise name_taken(kind, row.name) from None


def empty_part(dataset: str, part: str) -> Refused:
    return Refused(
        "empty_part", f"version {dataset!r} has no sequence in {part}; publish one that does, or choose another part"
    )
