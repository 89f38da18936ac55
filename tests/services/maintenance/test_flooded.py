"""What strangers have piled up makes no turn of the sweeper longer: each chore's work is counted, never timed."""

import shutil
from functools import partial
from pathlib import Path

import pytest
from sqlalchemy import func, select

from services.domain.benchmarks.submissions import sweeper_chores as submission_chores
from services.domain.notifications import spread
from services.domain.sequences import later_recordings
from services.maintenance import sweeper
from services.maintenance.notifications import delivery
from services.runtime.access import retention
from services.runtime.database.migrate import upgrade
from services.runtime.orm import Base
from services.runtime.platform import Platform
from services.runtime.settings import RetentionSettings
from services.runtime.store import garbage_collection
from services.runtime.store.gc_holds import GcCursor
from services.runtime.uploads.expiry import UploadCursor
from testing.once import made_once
from testing.servers.fixtures import make_settings, opened
from tests.services.maintenance.chores import CHORES
from tests.services.maintenance.flood import NOT_STRANGERS, PARTICULAR, Cost, cost_of, flood

SOME, MORE = 500, 1500
SMALL = 40


NAMES = tuple(name for names in CHORES.values() for name in names)


def lay(folder: Path) -> None:
    """Two platforms, one of which strangers have left much more on."""
    for name, rows in (("some", SOME), ("more", MORE)):
        platform = opened(make_settings(folder / name), [])
        upgrade(platform.settings)
        flood(platform, rows)
        platform.database.close()


@pytest.fixture
def flooded(tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of both, whose chores take small slices, so that `SOME` rows are many already."""
    for module in (submission_chores, retention, spread, delivery, later_recordings):
        monkeypatch.setattr(module, "AT_A_TIME", SMALL)
    monkeypatch.setattr(retention, "AUDIT_LINES_AT_A_TIME", SMALL)
    for name in ("MOST_TIMES", "MOST_AUDIT_TIMES"):
        monkeypatch.setattr(retention, name, 2)
    monkeypatch.setattr(garbage_collection, "BATCH", SMALL)
    uploads = partial(UploadCursor, slice_rows=SMALL, slice_files=SMALL)
    blobs = partial(GcCursor, share_s=0.0, slice_rows=SMALL, deleting_s=0.0, listed=SMALL, workspaces=SMALL)
    monkeypatch.setattr(sweeper, "UploadCursor", uploads)
    monkeypatch.setattr(sweeper, "GcCursor", blobs)
    return shutil.copytree(made_once(tmp_path_factory, "flooded", lay), tmp_path / "flooded")


def cost_of_turns(folder: Path, name: str) -> Cost:
    """What two turns of the chore cost, of which the second goes on where the first ended."""
    platform = opened(make_settings(folder, retention=RetentionSettings(audit_s=1.0)), [])
    chores = [chore for loop in sweeper.loops_of(platform) for chore in loop.chores]
    assert [chore.name for chore in chores] == list(NAMES)
    work = chores[NAMES.index(name)].work
    with cost_of(platform.database.engine) as cost:
        work()
        work()
    platform.database.close()
    return cost


@pytest.mark.whole
@pytest.mark.parametrize("name", NAMES)
def test_a_turn_of_a_chore_costs_no_more_where_strangers_have_left_more(flooded: Path, name: str) -> None:
    some, more = (cost_of_turns(flooded / left, name) for left in ("some", "more"))
    assert more.statements <= some.statements * 1.5 + 10, f"{some}, then {more}"
    assert more.steps <= some.steps * 1.5 + 50, f"{some}, then {more}"


def test_every_table_is_flooded_but_those_that_strangers_do_not_fill(platform: Platform) -> None:
    assert NOT_STRANGERS.keys() | PARTICULAR.keys() <= Base.metadata.tables.keys()
    flood(platform, 1)
    with platform.database.reading() as session:
        rows = {
            table.name: session.scalar(select(func.count()).select_from(table)) for table in Base.metadata.sorted_tables
        }
    assert {name for name, count in rows.items() if not count} == NOT_STRANGERS.keys()
