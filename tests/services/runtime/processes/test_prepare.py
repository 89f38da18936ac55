"""Preparing a release: bucket, schema, first administrator; a second time nothing."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from secrets import token_hex

import pytest
from botocore.config import Config
from pydantic import SecretStr
from sqlalchemy import select

from services.runtime.access.passwords import verify_password
from services.runtime.orm import User
from services.runtime.platform import Platform, open_platform
from services.runtime.processes.prepare import ensure_administrator, prepare
from services.runtime.processes.startup import await_schema
from services.runtime.settings import ApiSettings, DatabaseSettings, Settings
from services.runtime.store import s3
from services.runtime.store.bucket import ensure_bucket
from services.runtime.store.keys import StoreAwayError
from services.runtime.store.s3 import client_of
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer
from testing.servers.s3 import S3Server

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


def test_nobody_administers_where_no_first_password_is_given(platform_on: Platform) -> None:
    assert not ensure_administrator(platform_on)
    assert administrators(platform_on.settings) == []


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
    with pytest.raises(StoreAwayError):
        ensure_bucket(replace(standing, s3_endpoint="http://127.0.0.1:9"))


def test_a_wrong_key_is_no_reason_to_make_a_bucket(s3_server: S3Server) -> None:
    standing = replace(s3_server.settings(), s3_secret=SecretStr("wrong"))
    assert not ensure_bucket(standing)
