"""Somebody at a terminal: no login of theirs is read, and, if they have one, it is the owner's at a served platform."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from structlog.testing import capture_logs

from services.runtime.platform import Platform
from simulator.options import SimulateOptions
from simulator.pipeline import simulate
from testing.api.serving import Person, person, serving
from testing.once import made_once
from testing.worlds.benchmark_world import World
from tests.stone_client.participating import Served, joined, serving_world

TINY = SimulateOptions(seconds=1.0, channels=16, columns=180, cameras=False)


@pytest.fixture(autouse=True)
def nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nothing is remembered yet, and the log lines of a server in this process stay out of the command's stdout."""
    for name in ("STONE_URL", "STONE_TOKEN"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "configuration"))
    with capture_logs():
        yield


@pytest.fixture
def owner(platform: Platform) -> Person:
    return person(platform, "curator", "ada")


@pytest.fixture
def url(platform: Platform) -> Iterator[str]:
    with serving(platform) as address:
        yield address


@pytest.fixture
def as_owner(url: str, owner: Person, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("STONE_URL", url)
    monkeypatch.setenv("STONE_TOKEN", owner.secret)
    return url


@pytest.fixture(scope="session")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of a drive, with its calibration beside it; nobody writes to it."""
    return made_once(tmp_path_factory, "client-bag", lambda folder: simulate(folder / "run.mcap", TINY)) / "run.mcap"


@pytest.fixture(scope="module")
def served_world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[World, str]]:
    with serving_world(tmp_path_factory.mktemp("world")) as served:
        yield served


@pytest.fixture
def served(served_world: tuple[World, str], monkeypatch: pytest.MonkeyPatch) -> Served:
    """As the captain of a team that has sent nothing."""
    made = joined(*served_world)
    monkeypatch.setenv("STONE_URL", made.url)
    monkeypatch.setenv("STONE_TOKEN", made.captain.secret)
    return made
