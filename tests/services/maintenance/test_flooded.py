"""What strangers have piled up makes no turn of the sweeper longer: each chore's work is counted, never timed."""

from functools import partial

import pytest
from sqlalchemy import func, select

from services.domain.benchmarks.submissions import sweeper_chores as submission_chores
from services.domain.notifications import spread
from services.domain.sequences import later_recordings
from services.maintenance import sweeper
from services.maintenance.notifications import delivery
from services.runtime.access import retention
from services.runtime.orm import Base
from services.runtime.platform import Platform
from services.runtime.settings import RetentionSettings
from services.runtime.store import garbage_collection
from services.runtime.store.gc_holds import GcCursor
from services.runtime.uploads.expiry import UploadCursor
from tests.services.maintenance.flood import NOT_STRANGERS, PARTICULAR, cost_of, flood

SOME, MORE = 250, 750
SMALL = 40


CHORES = (
    *(
        "jobs",
        "submissions",
        "recordings",
        "submitted files",
        "uploads",
        "blobs",
        "credentials",
        "audit log",
        "workers",
    ),
    *("phases", "events", "deliveries", "lost deliveries", "old events", "senderone", "sendertwo"),
)


@pytest.fixture
def flooded(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> Platform:
    """A platform whose chores take small slices, so that `SOME` rows are many already."""
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
    flood(platform, SOME)
    settings = platform.settings.model_copy(update={"retention": RetentionSettings(audit_s=1.0)})
    return Platform(settings, platform.database, platform.store)


@pytest.mark.whole
@pytest.mark.parametrize("name", CHORES)
def test_a_turn_of_a_chore_costs_no_more_where_strangers_have_left_more(flooded: Platform, name: str) -> None:
    """But for a few rows that only the second turn meets."""
    chores = [chore for loop in sweeper.loops_of(flooded) for chore in loop.chores]
    assert [chore.name for chore in chores] == list(CHORES)
    work = chores[CHORES.index(name)].work
    with cost_of(flooded.database.engine) as before:
        work()
    flood(flooded, MORE, first=SOME)
    with cost_of(flooded.database.engine) as after:
        work()
    assert after.statements <= before.statements * 1.5 + 10, f"{before}, then {after}"
    assert after.steps <= before.steps * 1.5 + 50, f"{before}, then {after}"


def test_every_table_is_flooded_but_those_that_strangers_do_not_fill(platform: Platform) -> None:
    assert NOT_STRANGERS.keys() | PARTICULAR.keys() <= Base.metadata.tables.keys()
    flood(platform, 1)
    with platform.database.reading() as session:
        rows = {
            table.name: session.scalar(select(func.count()).select_from(table)) for table in Base.metadata.sorted_tables
        }
    assert {name for name, count in rows.items() if not count} == NOT_STRANGERS.keys()
