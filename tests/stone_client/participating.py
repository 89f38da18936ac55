"""A served platform with a benchmark and a worker that scores, and commands as one of its participants gives them."""

import json
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sqlalchemy import func, select
from typer.testing import CliRunner, Result

from services.domain.benchmarks.teams import teams
from services.eval.queue_handlers import handlers
from services.ingest import queue_handlers as ingest
from services.runtime.database.migrate import upgrade
from services.runtime.orm import SubmissionRow, Upload, new_id
from services.runtime.platform import Platform
from stone_client.main import app
from testing.api.serving import Person, person, serving
from testing.servers.fixtures import make_settings, opened
from testing.worlds.benchmark_world import World, benchmark_world, predicted, submission_zip
from tests.working import working


@dataclass(frozen=True)
class Served:
    """Where the world is served, and who asks: the captain of a team that nothing was ever submitted for."""

    world: World
    url: str
    captain: Person
    team: str
    team_id: str

    @property
    def platform(self) -> Platform:
        return self.world.platform

    def at(self, part: str) -> tuple[str, ...]:
        """The options that name the phase over this part."""
        return ("--benchmark", self.world.benchmark, "--phase", part)

    def count(self, row: type[SubmissionRow] | type[Upload]) -> int:
        """How many the team has sent."""
        owned = Upload.owner_id == self.captain.user_id if row is Upload else SubmissionRow.team_id == self.team_id
        with self.platform.database.reading() as session:
            return session.scalar(select(func.count()).select_from(row).where(owned)) or 0


@contextmanager
def serving_world(root: Path, frames: int = 1) -> Iterator[tuple[World, str]]:
    """A world of its own below `root`, and its URL."""
    platform = opened(make_settings(root), [])
    upgrade(platform.settings)
    try:
        world = benchmark_world(platform, frames)
        with serving(platform) as url:
            yield world, url
    finally:
        platform.database.close()


def joined(world: World, url: str) -> Served:
    """Somebody new, with a new team."""
    captain = person(world.platform, "participant")
    name = f"crew-{new_id()[-8:]}"
    with world.platform.database.transaction() as session:
        team_id = teams.create_team(session, name, captain.user_id).id
    return Served(world, url, captain, name, team_id)


def stone(*arguments: object, stdin: str = "") -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], input=stdin)


def answered(*arguments: object) -> dict[str, Any]:
    """What the command prints under --json."""
    result = stone(*arguments, "--json")
    assert result.exit_code == 0, (result.stdout, result.stderr, result.exception)
    record: dict[str, Any] = json.loads(result.stdout)
    return record


def refused(result: Result) -> str:
    """The refusal's code; a traceback is none."""
    assert result.exit_code == 1, (result.stdout, result.stderr, result.exception)
    return result.stderr.rstrip("\n").splitlines()[-1].partition(":")[0]


def zipped(served: Served, path: Path, part: str = "val", errors: float = 0.1, seed: int = 1) -> Path:
    """Predictions of a part with about this share of errors."""
    return submission_zip(path, predicted(served.world.truth(part), errors, seed))


def scoring(platform: Platform) -> AbstractContextManager[None]:
    """A worker of the queue `eval` in a thread."""
    return working(platform, "eval", handlers)


def ingesting(platform: Platform) -> AbstractContextManager[None]:
    """A worker of the queue `ingest` in a thread."""
    return working(platform, "ingest", ingest.handlers)


def quiet(stage: str, done: int, total: int) -> None:
    """Nobody watches."""
