"""A round of each kind with real processes, and a kill that destroys something, which must be seen."""

import re
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from chaos import scoring
from chaos.inputs import Inputs, simulated
from chaos.kinds import KINDS, Kind, undisturbed
from chaos.places import PlatformUnderTest, platform_under_test
from chaos.result_hashes import OwnerRun
from chaos.rounds import RoundSeries, Suite, play, play_in, run_undisturbed
from chaos.table import table_of
from chaos.turns import OwnerRound
from services.runtime.orm import Artefact, Blob

SEED = 3
WORKER = next(kind for kind in KINDS if kind.name == "worker")


@dataclass(frozen=True)
class Stand:
    """A place and what was made in it undisturbed."""

    target: PlatformUnderTest
    calm: RoundSeries


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    return simulated(tmp_path_factory.mktemp("inputs"))


@pytest.fixture(scope="module", autouse=True)
def own_home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """What the client remembers stays in the tests' folder."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("STONE_CONFIG_HOME", str(tmp_path_factory.mktemp("home")))
        yield


@pytest.fixture(scope="module")
def stand(inputs: Inputs, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stand]:
    """The embedded platform, run in once: the kinds that need nothing else are played in it one after another."""
    folder, told = tmp_path_factory.mktemp("stand"), list[str]()
    calm = RoundSeries(Kind("calm", "nothing", undisturbed))
    with platform_under_test(folder / "place", inputs, told.append, on_postgres=False) as target:
        run_undisturbed(suite(inputs, folder, told), calm, target)
        yield Stand(target, calm)


def suite(inputs: Inputs, folder: Path, told: list[str]) -> Suite:
    return Suite(SEED, 1, folder / "places", inputs, time.monotonic() + 600.0, told.append, undisturbed_runs=1)


def spoil(turn: OwnerRound) -> OwnerRun:
    """A platform that forgets: an artefact is gone once the run has published it."""
    brought = undisturbed(turn)
    turn.note("artefact", is_hit=True)
    platform = turn.target.platform
    with platform.database.reading() as session:
        table = session.scalars(select(Artefact).where(Artefact.name == "frames.parquet")).first()
        assert table is not None
        platform.store.delete(session.get_one(Blob, table.blob_sha256).object_key)
    return brought


def of(kinds: Sequence[Kind]) -> Any:
    return pytest.mark.parametrize("kind", [pytest.param(kind, id=kind.name) for kind in kinds])


def found_good(series: RoundSeries, told: Sequence[str]) -> None:
    assert [violation for ended in series.rounds for violation in ended.violations] == [], told
    assert [ended.is_hit for ended in series.rounds] == [True], told
    assert series.is_proven


@pytest.mark.release
def test_nothing_is_lost_doubled_or_different_when_a_worker_is_killed(inputs: Inputs, tmp_path: Path) -> None:
    """Catches alone what a `kill -9` of a real process loses between the queue, database and store."""
    told: list[str] = []
    found_good(play(suite(inputs, tmp_path, told), WORKER), told)
    assert list((tmp_path / "places").iterdir()) == [], "the place of a good round is cleared away"


@pytest.mark.release
@of([kind for kind in KINDS if kind != WORKER and not kind.on_postgres])
def test_nor_when_something_else_of_the_embedded_platform_is(
    kind: Kind, inputs: Inputs, stand: Stand, tmp_path: Path
) -> None:
    """Catches alone what a `kill -9` of the API, the client, Redis or the sweeper loses."""
    told: list[str] = []
    series = RoundSeries(kind, stand.calm.made, undisturbed=stand.calm.undisturbed)
    play_in(suite(inputs, tmp_path, told), series, stand.target)
    found_good(series, told)


@pytest.mark.release
@of([kind for kind in KINDS if kind.on_postgres])
def test_nor_when_something_of_a_cluster_is(kind: Kind, inputs: Inputs, tmp_path: Path) -> None:
    """Catches alone what is lost between PostgreSQL, an S3 store and the processes, one of which is killed."""
    told: list[str] = []
    found_good(play(suite(inputs, tmp_path, told), kind), told)


@pytest.mark.release
def test_what_is_really_destroyed_is_told_and_its_place_kept(inputs: Inputs, tmp_path: Path) -> None:
    """Catches alone a round that ends well whatever was lost in it."""
    told: list[str] = []
    series = play(suite(inputs, tmp_path, told), Kind("spoil", "an artefact is deleted", spoil))
    assert not series.is_proven
    assert {violation.sort for violation in series.rounds[0].violations} == {"lost", "differing"}
    assert f"--only spoil --seed {SEED}" in (tmp_path / "places" / "spoil-1" / "violations.txt").read_text()
    row = [next(iter(column.cells)) for column in table_of([series], SEED, 1.0).columns]
    assert row[:3] == ["an artefact is deleted", "1", "1"]
    assert row[3] != "0"


@pytest.mark.release
def test_no_kill_costs_a_score_or_a_scoring(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Catches alone a score that a `kill -9` of a real worker loses, doubles or changes."""
    monkeypatch.setattr(sys, "argv", ["scoring", "--rounds", "3", "--seed", "3", "--folder", str(tmp_path / "place")])
    code = scoring.main()
    said = capsys.readouterr().out
    assert code == 0, said
    assert re.search(r"\d rounds, 3 hit work", said), said  # a round that hits nothing is played again
    assert "lost 0, doubled 0, differing 0" in said
