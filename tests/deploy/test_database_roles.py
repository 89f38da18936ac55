"""Each service connects with its own PostgreSQL role, which suffices for its work and owns nothing.

The processes are those of docker-compose.yml, on a server that requires passwords; the demo runs through them.
"""

import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from secrets import token_hex

import psycopg
import pytest
from psycopg.errors import InsufficientPrivilege
from pydantic import SecretStr

from services.runtime.database.roles import CREDENTIALS, READ_ONLY, ROLES, WORKERS, ensure_roles, name_of
from services.runtime.embedded.supervisor import environment_of
from services.runtime.orm.base import Base
from services.runtime.processes.prepare import prepare
from services.runtime.settings import ApiSettings, BrokerSettings, DatabaseSettings, Settings, ViewingSettings
from stone_client.credentials import choose_server
from stone_client.sign_in import sign_in_by_password
from stone_local.demo import pipeline
from stone_local.demo.pipeline import DemoPlan, run_demo
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer, running_postgres_with_passwords
from testing.servers.process import ServerProcess, answers, free_port
from testing.servers.redis import running_redis
from testing.worlds.demo import SMALL, SPARSER

FIRST_PASSWORD = "a password that nobody had before"
pytestmark = pytest.mark.whole

MODULES = {
    "api": ("services.runtime.processes.api",),
    "beat": ("services.maintenance.sweeper",),
    **{service: ("services.runtime.processes.worker", service) for service in WORKERS},
}


@dataclass(frozen=True)
class Deployment:
    """A prepared database, and the settings of each service by its own role."""

    server: PostgresServer
    owner: Settings

    def of(self, service: str) -> Settings:
        return self.owner.model_copy(
            update={
                "database": DatabaseSettings(
                    f"postgresql://{name_of(service)}@127.0.0.1:{self.server.port}/stone",
                    getattr(self.owner.database, f"{service}_password"),
                    pool_size=4,
                )
            }
        )

    def connection(self, service: str) -> psycopg.Connection[tuple[object, ...]]:
        database = self.of(service).database
        return psycopg.connect(database.url, password=database.password.get_secret_value(), autocommit=True)


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    """Yield a PostgreSQL server that requires a password from every role except its superuser."""
    with running_postgres_with_passwords() as running:
        yield running


@pytest.fixture(scope="module")
def deployment(server: PostgresServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Deployment]:
    server.run("CREATE DATABASE stone")
    port = free_port()
    passwords = {f"{service}_password": SecretStr(token_hex(8)) for service in ROLES}
    with running_redis() as redis:
        settings = make_settings(
            tmp_path_factory.mktemp("deployment"),
            workers=2,
            database=replace(DatabaseSettings(server.url("stone")), **passwords),
            broker=BrokerSettings(redis.url),
            api=ApiSettings(
                port=port,
                url=f"http://127.0.0.1:{port}",
                pages=False,
                first_password=SecretStr(FIRST_PASSWORD),
            ),
            viewing=ViewingSettings(),
        )
        prepare(settings)
        yield Deployment(server, settings)


@contextmanager
def running(deployment: Deployment, service: str) -> Iterator[Path]:
    """Run a process of the service; yield its log."""
    settings = deployment.of(service)
    place = deployment.owner.root / f"process-{service}"
    place.mkdir(parents=True)
    port = settings.api.port
    process = ServerProcess(
        [sys.executable, "-P", "-m", *MODULES[service]],
        place,
        (lambda: answers(port)) if service == "api" else (lambda: True),
        environment=environment_of(settings),
    )
    process.start()
    try:
        yield process.log
    finally:
        process.stop()


@pytest.mark.release
def test_the_demo_goes_through_services_that_each_have_a_role(
    deployment: Deployment, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Catches alone a right that a service needs and does not have."""
    monkeypatch.setattr(pipeline, "SPARSE", SPARSER)
    monkeypatch.setenv("STONE_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "demo").mkdir()
    with ExitStack() as stack:
        logs = [stack.enter_context(running(deployment, service)) for service in ROLES]
        url = deployment.owner.api.url
        sign_in_by_password(url, "admin", FIRST_PASSWORD, as_administrator=True)
        record = run_demo(tmp_path / "demo", DemoPlan(SMALL, choose_server(url)), lambda *_: None)
    assert record["benchmark"]["board"]["rows"]
    for log in logs:
        assert "permission denied" not in log.read_text("utf-8", "replace"), log


@pytest.mark.parametrize("service", ROLES)
def test_a_service_changes_no_schema_and_becomes_nobody_else(deployment: Deployment, service: str) -> None:
    with deployment.connection(service) as connection:
        for statement in (
            "ALTER TABLE audit_log DISABLE TRIGGER ALL",
            "DROP TABLE scores",
            "CREATE TABLE mine (a integer)",
            "CREATE ROLE other",
            "SET ROLE postgres",
            "COPY (SELECT 1) TO PROGRAM 'true'",
            "SELECT pg_read_file('/etc/passwd')",
            "UPDATE alembic_version SET version_num = '0'",
        ):
            with pytest.raises(InsufficientPrivilege):
                connection.execute(statement)


@pytest.mark.parametrize("service", WORKERS)
def test_a_worker_reads_no_credential_and_writes_no_table_of_others(deployment: Deployment, service: str) -> None:
    with deployment.connection(service) as connection:
        connection.execute("SELECT id, name, role FROM users FOR KEY SHARE")
        refused = [f"SELECT * FROM {table}" for table in sorted(CREDENTIALS)]
        refused += ["SELECT password_hash FROM users", "UPDATE users SET role = 'administrator'", "DELETE FROM users"]
        refused += [f"DELETE FROM {table}" for table in sorted(READ_ONLY[service])]
        for statement in refused:
            with pytest.raises(InsufficientPrivilege):
                connection.execute(statement)


def test_every_table_with_a_secret_is_closed_to_workers() -> None:
    """Catches a new table of credentials that the list of closed tables lacks."""
    secret = {
        name
        for name, table in Base.metadata.tables.items()
        if any(column.name.endswith(("_hash", "secret", "csrf_token")) for column in table.columns)
    }
    assert secret - {"users"} <= CREDENTIALS <= set(Base.metadata.tables)
    assert set().union(*READ_ONLY.values()) <= set(Base.metadata.tables) - CREDENTIALS


def test_another_password_is_that_of_the_role_after_the_next_preparation(deployment: Deployment) -> None:
    changed = replace(deployment.owner.database, eval_password=SecretStr("another"))
    other = Deployment(deployment.server, deployment.owner.model_copy(update={"database": changed}))
    with pytest.raises(psycopg.OperationalError, match="password authentication failed"):
        other.connection("eval")
    assert ensure_roles(other.owner)
    other.connection("eval").close()
    ensure_roles(deployment.owner)


def test_some_passwords_without_the_others_are_refused(settings: Settings) -> None:
    some = replace(settings.database, api_password=SecretStr("one"))
    with refused_as("impossible_settings", match="STONE_DATABASE__BEAT_PASSWORD"):
        ensure_roles(settings.model_copy(update={"database": some}))
    assert not ensure_roles(settings)
