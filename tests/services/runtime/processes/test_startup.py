"""A release is prepared, and started: what begins before the schema of its code waits; the impossible is refused."""

import time
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from secrets import token_hex

import pytest
from botocore.config import Config
from pydantic import SecretStr
from sqlalchemy import select, text
from sqlalchemy.exc import OperationalError

from services.runtime.access.passwords import verify_password
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.orm import User
from services.runtime.platform import Platform, open_platform
from services.runtime.processes import startup
from services.runtime.processes.prepare import ensure_administrator, prepare
from services.runtime.processes.startup import await_schema, insist
from services.runtime.processes.worker import FORKED_FROM
from services.runtime.settings import ApiSettings, DatabaseSettings, Settings
from services.runtime.store import s3
from services.runtime.store.s3 import client_of, ensure_bucket
from stone.errors import PlatformFaultError
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer
from testing.servers.s3 import S3Server


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "PAUSE_S", 0.0)


def impatient(settings: Settings) -> Settings:
    return settings.model_copy(update={"database": replace(settings.database, awaited_s=0.0)})


def test_an_empty_database_is_waited_for_until_it_is_prepared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    settings = make_settings(tmp_path)
    monkeypatch.setattr(time, "sleep", lambda _: upgrade(settings))
    await_schema(settings)


def test_a_database_that_stays_empty_is_said_so(tmp_path: Path) -> None:
    with refused_as("schema_missing"):
        await_schema(impatient(make_settings(tmp_path)))


def test_a_database_of_an_older_release_is_said_so(platform: Platform, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "head_revision", lambda: "9999")
    with refused_as("schema_missing"):
        await_schema(impatient(platform.settings))


@pytest.mark.parametrize(("revision", "code"), [("9999", "schema_newer"), ("0029", "schema_older")])
def test_a_database_that_this_release_cannot_upgrade_is_refused_without_waiting(
    platform: Platform, revision: str, code: str
) -> None:
    _stand_at(platform, revision)
    with refused_as(code):
        await_schema(platform.settings)


def test_a_database_that_is_away_is_waited_for_and_then_reported(tmp_path: Path) -> None:
    nowhere = DatabaseSettings("postgresql://nobody@127.0.0.1:9/none", awaited_s=0.0)
    with pytest.raises(OperationalError):
        await_schema(make_settings(tmp_path, database=nowhere))


def test_outages_are_waited_out_and_nothing_else_is() -> None:
    left: list[Exception] = [
        PlatformFaultError("store_unavailable", "the store is away"),
        OperationalError("SELECT 1", {}, OSError("gone")),
    ]

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


PASSWORD = "correct horse battery staple"


@pytest.fixture
def bare(tmp_path: Path, postgres_server: PostgresServer, s3_server: S3Server) -> Iterator[Settings]:
    """Servers as a first start finds them: an empty database, a store without the bucket."""
    store = replace(s3_server.settings("there-already"), s3_bucket=f"new-{token_hex(6)}")
    with postgres_server.fresh_database() as url:
        database = DatabaseSettings(url, awaited_s=5.0)
        api = ApiSettings(first_password=SecretStr(PASSWORD))
        yield make_settings(tmp_path, database=database, store=store, api=api)


def administrators(settings: Settings) -> list[User]:
    platform = open_platform(settings)
    with platform.database.reading() as session:
        found = session.scalars(select(User).where(User.role == "administrator")).all()
    platform.database.close()
    return list(found)


def test_a_release_on_empty_servers_is_prepared_once(bare: Settings) -> None:
    prepare(bare)
    await_schema(bare)
    client_of(bare.store).head_bucket(Bucket=bare.store.s3_bucket)
    (first,) = administrators(bare)
    assert first.name == "admin"
    assert verify_password(first.password_hash, PASSWORD)
    prepare(bare)
    assert [user.id for user in administrators(bare)] == [first.id]


def test_nobody_administers_where_no_first_password_is_given(platform: Platform) -> None:
    assert not ensure_administrator(platform)
    assert administrators(platform.settings) == []


def test_a_password_that_was_changed_is_left(platform: Platform) -> None:
    first = platform.settings.model_copy(update={"api": ApiSettings(first_password=SecretStr(PASSWORD))})
    assert ensure_administrator(Platform(first, platform.database, platform.store))
    (before,) = administrators(platform.settings)
    other = platform.settings.model_copy(update={"api": ApiSettings(first_password=SecretStr("x" * 24))})
    assert not ensure_administrator(Platform(other, platform.database, platform.store))
    assert [user.password_hash for user in administrators(platform.settings)] == [before.password_hash]


def test_a_bucket_that_stands_is_left_and_a_store_that_is_away_is_said_so(
    s3_server: S3Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    standing = s3_server.settings()
    assert not ensure_bucket(standing)
    once = Config(retries={"mode": "standard", "total_max_attempts": 1})
    monkeypatch.setattr(s3, "CLIENT", s3.CLIENT.merge(once))
    with refused_as("store_unavailable"):
        ensure_bucket(replace(standing, s3_endpoint="http://127.0.0.1:9"))


def test_a_wrong_key_is_no_reason_to_make_a_bucket(s3_server: S3Server) -> None:
    standing = replace(s3_server.settings(), s3_secret=SecretStr("wrong"))
    assert not ensure_bucket(standing)


@pytest.mark.parametrize("queue", QUEUES)
def test_a_fork_server_can_load_what_it_is_told_to(queue: str) -> None:
    for loaded in FORKED_FROM[queue]:
        module, _, function = loaded.partition(":")
        assert not function or callable(getattr(import_module(module), function))
