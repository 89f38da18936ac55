"""A round of each kind with real processes, and a kill that destroys something, which must be seen."""

import time
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import select

from chaos.inputs import Inputs, simulated
from chaos.kinds import KINDS, Kind, undisturbed
from chaos.result_hashes import OwnerRun
from chaos.rounds import Suite, play
from chaos.table import table_of
from chaos.turns import OwnerRound
from services.runtime.orm import Artefact, Blob

SEED = 3
EVERYDAY = "worker"


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Inputs:
    return simulated(tmp_path_factory.mktemp("inputs"))


@pytest.fixture(autouse=True)
def own_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the client remembers stays in the test's folder."""
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "home"))


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


def in_its_tier(kind: Kind) -> Any:
    return pytest.param(kind, id=kind.name, marks=() if kind.name == EVERYDAY else pytest.mark.whole)


@pytest.mark.parametrize("kind", [in_its_tier(kind) for kind in KINDS])
def test_nothing_is_lost_doubled_or_different(kind: Kind, inputs: Inputs, tmp_path: Path) -> None:
    """Catches alone what a `kill -9` of a real process loses between the queue, the database and the store."""
    told: list[str] = []
    series = play(suite(inputs, tmp_path, told), kind)
    assert [violation for ended in series.rounds for violation in ended.violations] == [], told
    assert [ended.is_hit for ended in series.rounds] == [True], told
    assert series.is_proven
    assert list((tmp_path / "places").iterdir()) == [], "the place of a good round is cleared away"


@pytest.mark.whole
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
