"""What tests of the rules stand on: a version of the dataset, a phase, people and their entries, as rows only."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import select

from services.domain.benchmarks.phases.phases import NewBenchmark, NewPhase, create_benchmark, create_phase
from services.domain.benchmarks.teams import teams
from services.domain.datasets.queries import dataset_named
from services.runtime.orm import (
    Dataset,
    DatasetMember,
    GroundTruthRow,
    Phase,
    SubmissionRow,
    Team,
    TeamMember,
    User,
    new_id,
)
from services.runtime.orm.base import now_ns
from services.runtime.platform import Platform
from services.runtime.store import blobs
from stone.errors import StoneError
from testing import threads
from testing.api.serving import Person, person
from testing.worlds import published

Act = Callable[[Any], object]
"""What is done in a session."""

VAL = NewPhase("val", "val", is_hidden=False)
TEST = NewPhase("test", "test", is_hidden=True)


def version(platform: Platform, owner: Person, **parts: list[str]) -> Dataset:
    """A version of these sequences; of a fresh one each in train, val and test where none is named."""
    named_parts = parts or {part: [published.published_sequence(platform, owner.user_id)] for part in ("val", "test")}
    name = published.dataset(platform, owner.user_id, named_parts)
    with platform.database.reading() as session:
        found = dataset_named(session, name)
    assert found is not None
    return found


def bare_version(platform: Platform, owner: Person) -> Dataset:
    """A version with a sequence in val and one in test, of which there are no files: quickly made."""
    path = platform.settings.root / f"made-{new_id()}"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"{}")
    with platform.database.transaction() as session:
        row = Dataset(name=f"v-{new_id()[-8:]}", code_version="1", manifest_bytes=2, created_by=owner.user_id)
        row.manifest_sha256 = blobs.keep(session, platform.store, path).sha256
        session.add(row)
        session.flush()
        said = {"environment": "", "illumination": "", "region": "", "recipe": "", "frames": 1, "duration_ns": 1}
        for part in ("val", "test"):
            ids = {"dataset_id": row.id, "sequence_id": new_id(), "label_set_id": new_id()}
            session.add(DatasetMember(part=part, name=part, **ids, **said))
        return row


def phase(platform: Platform, owner: Person, dataset: Dataset, asked: NewPhase = TEST, **rules: Any) -> Phase:
    """A phase of a benchmark of its own."""
    with platform.database.transaction() as session:
        benchmark = create_benchmark(session, NewBenchmark(f"stone-{new_id()[-8:]}", "STONE", "", owner.user_id))
        return create_phase(session, benchmark, dataset, replace(asked, rules=replace(asked.rules, **rules)))


def hidden_phase(platform: Platform, **rules: Any) -> Phase:
    """A phase over test, of a version without files."""
    root = person(platform, "administrator")
    return phase(platform, root, bare_version(platform, root), **rules)


def entry(platform: Platform, phase_id: str, team_id: str, user_id: str, **columns: Any) -> str:
    """The id of a submission, scored unless said otherwise."""
    row = SubmissionRow(phase_id=phase_id, team_id=team_id, user_id=user_id, method="m", modality="L", state="scored")
    row.declared_sha256, row.size_bytes, row.finalized_ns = "0" * 64, 1, now_ns()
    for name, value in columns.items():
        setattr(row, name, value)
    with platform.database.transaction() as session:
        session.add(row)
    return row.id


def user(platform: Platform, name: str = "") -> User:
    with platform.database.reading() as session:
        return session.get_one(User, person(platform, "participant", name).user_id)


def team(platform: Platform, captain: User, *members: User) -> Team:
    with platform.database.transaction() as session:
        row = teams.create_team(session, f"team-{new_id()[-8:]}", captain.id)
        for member in members:
            teams.join(session, teams.invite(session, row, captain), member)
        return row


def ready(platform: Platform, truth_id: str) -> None:
    """Make the ground truth look made, as its job would."""
    with platform.database.transaction() as session:
        session.get_one(GroundTruthRow, truth_id).ready_ns = now_ns()


def at_once(platform: Platform, *acts: Act) -> list[str]:
    """The codes of what each act met, in a transaction of its own, all begun at one moment ("" for success)."""

    def code_of(number: int) -> str:
        try:
            with platform.database.transaction() as session:
                acts[number](session)
        except StoneError as error:
            return error.code
        return ""

    return threads.at_once(len(acts), code_of)


def rows(platform: Platform, statement: Any) -> Sequence[Any]:
    with platform.database.reading() as session:
        return session.scalars(statement).all()


def members_of(platform: Platform, team_id: str) -> set[str]:
    return set(rows(platform, select(TeamMember.user_id).where(TeamMember.team_id == team_id)))
