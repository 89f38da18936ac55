"""Fixtures over real servers: started when a test first asks, one of each per test process, ended with it.

**Conventions.** `platform` is the embedded shape (migrated SQLite, folder store); `platform_on` runs a test on SQLite
and on PostgreSQL. Their wake-ups are collected in `bells` as (queue, times) and sent nowhere. Every test has a database
of its own, copied from one that was migrated once.
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
    """Settings whose data folder is below `tmp_path`; `groups` as in `Settings`.

    Workers do not rest for long, and nothing is made that nobody asked for.
    """
    usual = {
        "jobs": JobSettings(rest_s=0.1),
        "viewing": ViewingSettings(makes_playback=False),
        "store": StoreSettings(reserve_bytes=NO_RESERVE),  # how full this machine is decides no test
    }
    return Settings(data_folder=tmp_path / "data", **{**usual, **groups})


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    with running_postgres() as server:
        yield server


@pytest.fixture(scope="session")
def postgres_url(postgres_server: PostgresServer) -> str:
    """A server's maintenance database; tables belong into `fresh_postgres_url`."""
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
    """A provider of OpenID Connect; who it is to know, a test says."""
    with running_oidc() as server:
        yield server


@pytest.fixture
def s3_settings(s3_server: S3Server) -> StoreSettings:
    """A bucket of the test's own."""
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
    """A migrated, empty database of the test's own."""
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
    """What the platform of the test rang."""
    return []


def opened(settings: Settings, bells: Bells) -> Platform:
    """A platform that sends wake-ups into `bells`."""
    database = Database(settings, lambda queue, times: bells.append((queue, times)))
    return Platform(settings, database, open_store(settings))


def having(platform: Platform, **groups: Mapping[str, Any]) -> Platform:
    """The platform with other values of some settings, by their group."""
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
    """Settings of a database without any table, on both."""
    if request.param == "sqlite":
        yield make_settings(tmp_path)
        return
    server: PostgresServer = request.getfixturevalue("postgres_server")
    with server.fresh_database() as url:
        yield make_settings(tmp_path, database=DatabaseSettings(url))
