"""Fixtures over real servers: each server starts at its first use, one per test process, and ends with the process.

**Conventions.** `platform` is the embedded form (migrated SQLite, folder store); `platform_on` runs a test on SQLite
and on PostgreSQL. Their wake-ups are collected in `bells` as (queue, times) and not sent. Every test has its own
database, copied from a migrated template.
"""

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.platform import Platform
from services.runtime.settings import DatabaseSettings, JobSettings, Settings, StoreSettings, ViewingSettings
from services.runtime.store.factory import open_store
from services.runtime.store.free_space import NO_RESERVE
from testing.servers.oidc import OidcServer, running_oidc
from testing.servers.postgres import PostgresServer, running_postgres
from testing.servers.redis import RedisServer, running_redis
from testing.servers.s3 import S3Server, running_s3

TEMPLATE = "stone_template"
Bells = list[tuple[str, int]]


def make_settings(tmp_path: Path, **groups: Any) -> Settings:
    """Return settings with a data folder below `tmp_path`; `groups` as in `Settings`.

    Workers rest only briefly, and no automatic results are made.
    """
    usual = {
        "jobs": JobSettings(rest_s=0.1),
        "viewing": ViewingSettings(makes_playback=False),
        "store": StoreSettings(reserve_bytes=NO_RESERVE),  # the free space of this machine affects no test
    }
    return Settings(data_folder=tmp_path / "data", **{**usual, **groups})


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    with running_postgres() as server:
        yield server


@pytest.fixture(scope="session")
def postgres_url(postgres_server: PostgresServer) -> str:
    """The URL of a server's maintenance database; create tables in `fresh_postgres_url`."""
    return postgres_server.url()


@pytest.fixture(scope="session")
def redis_server() -> Iterator[RedisServer]:
    with running_redis() as server:
        yield server


@pytest.fixture(scope="session")
def redis_url(redis_server: RedisServer) -> str:
    return redis_server.url


@pytest.fixture(scope="session")
def s3_server() -> Iterator[S3Server]:
    with running_s3() as server:
        yield server


@pytest.fixture(scope="session")
def oidc_server() -> Iterator[OidcServer]:
    """A provider of OpenID Connect; each test defines its users."""
    with running_oidc() as server:
        yield server


@pytest.fixture
def s3_settings(s3_server: S3Server) -> StoreSettings:
    """Settings of the test's own bucket."""
    return s3_server.settings()


@pytest.fixture(scope="session")
def _postgres_template(postgres_server: PostgresServer, tmp_path_factory: pytest.TempPathFactory) -> str:
    postgres_server.run(f"CREATE DATABASE {TEMPLATE}")
    folder = tmp_path_factory.mktemp("template")
    upgrade(make_settings(folder, database=DatabaseSettings(postgres_server.url(TEMPLATE))))
    return TEMPLATE


@pytest.fixture(scope="session")
def _sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    settings = make_settings(tmp_path_factory.mktemp("template"))
    upgrade(settings)
    return settings.root / "stone.sqlite3"


@pytest.fixture
def fresh_postgres_url(postgres_server: PostgresServer, _postgres_template: str) -> Iterator[str]:
    """The URL of the test's own migrated, empty database."""
    with postgres_server.fresh_database(_postgres_template) as url:
        yield url


@pytest.fixture
def settings(tmp_path: Path, _sqlite_template: Path) -> Settings:
    """Settings of the embedded platform, its database migrated."""
    made = make_settings(tmp_path)
    made.root.mkdir(parents=True)
    shutil.copyfile(_sqlite_template, made.root / "stone.sqlite3")
    return made


@pytest.fixture
def bells() -> Bells:
    """The wake-ups of the test's platform."""
    return []


def opened(settings: Settings, bells: Bells) -> Platform:
    """Return a platform that sends wake-ups into `bells`."""
    database = Database(settings, lambda queue, times: bells.append((queue, times)))
    return Platform(settings, database, open_store(settings))


def having(platform: Platform, **groups: Mapping[str, Any]) -> Platform:
    """Return the platform with other values of some settings, by their group."""
    others = {group: replace(getattr(platform.settings, group), **values) for group, values in groups.items()}
    return replace(platform, settings=platform.settings.model_copy(update=others))


@pytest.fixture
def platform(settings: Settings, bells: Bells) -> Iterator[Platform]:
    made = opened(settings, bells)
    yield made
    made.database.close()


@pytest.fixture
def on_postgres(fresh_postgres_url: str, tmp_path: Path, bells: Bells) -> Iterator[Platform]:
    """The platform on PostgreSQL alone."""
    made = opened(make_settings(tmp_path, database=DatabaseSettings(fresh_postgres_url)), bells)
    yield made
    made.database.close()


@pytest.fixture(params=["sqlite", "postgres"])
def platform_on(request: pytest.FixtureRequest) -> Platform:
    made: Platform = request.getfixturevalue("platform" if request.param == "sqlite" else "on_postgres")
    return made


@pytest.fixture(params=["sqlite", "postgres"])
def empty(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Settings]:
    """Settings of a database without any table, on SQLite and PostgreSQL."""
    if request.param == "sqlite":
        yield make_settings(tmp_path)
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        yield make_settings(tmp_path, database=DatabaseSettings(url))
