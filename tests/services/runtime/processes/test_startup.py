"""What is started before the schema of its code waits; what can never be is refused at once."""

import time
from dataclasses import replace
from pathlib import Path

import pytest
from sqlalchemy import text
from sqlalchemy.exc import OperationalError

from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.errors import NewerSchemaError
from services.runtime.platform import Platform
from services.runtime.processes import startup
from services.runtime.processes.startup import SchemaMissingError, await_schema, insist
from services.runtime.settings import DatabaseSettings, Settings
from stone.errors import PlatformFaultError
from testing.servers.fixtures import make_settings


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "PAUSE_S", 0.0)


def impatient(settings: Settings) -> Settings:
    return settings.model_copy(update={"database": replace(settings.database, awaited_s=0.0)})


def test_a_prepared_database_is_not_waited_for(platform_on: Platform) -> None:
    await_schema(impatient(platform_on.settings))


def test_an_empty_database_is_waited_for_until_it_is_prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = make_settings(tmp_path)
    monkeypatch.setattr(time, "sleep", lambda _: upgrade(settings))
    await_schema(settings)


def test_a_database_that_stays_empty_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(SchemaMissingError, match=r"is empty and this version works on '\d+.*prepare"):
        await_schema(impatient(make_settings(tmp_path)))


def test_a_database_of_an_older_release_is_said_so(platform: Platform) -> None:
    _stand_at(platform, "0001")
    with pytest.raises(SchemaMissingError, match="at revision '0001'"):
        await_schema(impatient(platform.settings))


def test_a_database_of_a_newer_release_is_refused_without_waiting(platform: Platform) -> None:
    _stand_at(platform, "9999")
    with pytest.raises(NewerSchemaError, match="9999"):
        await_schema(platform.settings)


def test_a_database_that_is_away_is_waited_for_and_then_reported(tmp_path: Path) -> None:
    nowhere = DatabaseSettings("postgresql://nobody@127.0.0.1:9/none", awaited_s=0.0)
    with pytest.raises(OperationalError):
        await_schema(make_settings(tmp_path, database=nowhere))


def test_outages_are_waited_out_and_nothing_else_is() -> None:
    left: list[Exception] = [PlatformFaultError("store away"), OperationalError("SELECT 1", {}, OSError("gone"))]

    def act() -> str:
        if left:
            raise left.pop()
        return "done"

    assert insist(act, within_s=60.0) == "done"
    left.append(KeyError("a bug"))
    with pytest.raises(KeyError):
        insist(act, within_s=60.0)


def _stand_at(platform: Platform, revision: str) -> None:
    database = Database(platform.settings)
    with database.transaction() as session:
        session.execute(text("UPDATE alembic_version SET version_num = :revision"), {"revision": revision})
    database.close()
