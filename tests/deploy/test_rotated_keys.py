"""Keys are exchanged as docs/operations/keys.md says, on real servers: who works meanwhile notices nothing."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import SecretStr
from sqlalchemy import select, text
from sqlalchemy.exc import OperationalError

from services.runtime.access.users import create_user
from services.runtime.database.migrate import upgrade
from services.runtime.database.transactions import Database
from services.runtime.orm import User
from services.runtime.settings import DatabaseSettings, Settings
from services.runtime.store.s3 import S3Store
from testing.refusals import refused_as
from testing.servers.fixtures import make_settings
from testing.servers.postgres import PostgresServer, running_postgres_with_passwords
from testing.servers.s3 import running_s3

ROLES = (
    "CREATE ROLE stone_owner NOLOGIN",
    "CREATE ROLE stone_a LOGIN PASSWORD 'first' IN ROLE stone_owner",
    "CREATE ROLE stone_b LOGIN PASSWORD 'second' IN ROLE stone_owner",
    "ALTER ROLE stone_a SET role = 'stone_owner'",
    "ALTER ROLE stone_b SET role = 'stone_owner'",
    "CREATE DATABASE stone OWNER stone_owner",
)
PAGE = Path(__file__).resolve().parents[2] / "docs" / "operations" / "keys.md"


@pytest.fixture
def asking_server() -> Iterator[PostgresServer]:
    """PostgreSQL that asks everybody but its superuser for a password."""
    with running_postgres_with_passwords() as server:
        yield server


def connecting(server: PostgresServer, folder: Path, role: str, password: str) -> Settings:
    url = f"postgresql://{role}@127.0.0.1:{server.port}/stone"
    return make_settings(folder, database=DatabaseSettings(url, SecretStr(password)))


def names(database: Database) -> list[str]:
    with database.reading() as session:
        return sorted(session.scalars(select(User.name)))


def test_the_databases_password_is_exchanged_under_a_platform_that_works(
    asking_server: PostgresServer, tmp_path: Path
) -> None:
    for statement in ROLES:
        asking_server.run(statement)
    old = connecting(asking_server, tmp_path, "stone_a", "first")
    upgrade(old)
    working = Database(old)
    with working.transaction() as session:
        create_user(session, "ada", "curator")
    asking_server.run("ALTER ROLE stone_b PASSWORD 'new'")
    with pytest.raises(OperationalError, match="password authentication failed"):
        names(Database(connecting(asking_server, tmp_path, "stone_b", "second")))
    new = connecting(asking_server, tmp_path, "stone_b", "new")
    upgrade(new)  # what one role made, the other may change
    started = Database(new)
    with started.transaction() as session:
        create_user(session, "bea", "curator")
        session.execute(text("ALTER TABLE users ADD COLUMN proof integer"))
    assert names(working) == names(started) == ["ada", "bea"]
    working.close()
    asking_server.run("ALTER ROLE stone_a PASSWORD NULL")
    with pytest.raises(OperationalError):
        names(Database(old))
    assert names(started) == ["ada", "bea"]
    started.close()


def test_the_page_gives_the_very_roles_that_were_tried() -> None:
    page = PAGE.read_text("utf-8")
    assert all(f"{statement};" in page for statement in ROLES if "DATABASE" not in statement)


def test_the_key_of_the_store_is_exchanged_while_both_are_valid(tmp_path: Path) -> None:
    content = tmp_path / "content"
    content.write_bytes(b"labels")
    with running_s3() as server:
        first = server.settings("kept")
        second = replace(first, s3_key_id="second", s3_secret=SecretStr("another-secret"))
        old = S3Store(make_settings(tmp_path / "old", store=first))
        old.write("blobs/one", content)
        server.stop()
        server.command = [*server.command, "--auth-key", "second,another-secret"]
        server.start()
        new = S3Store(make_settings(tmp_path / "new", store=second))
        old.write("blobs/two", content)
        assert b"".join(new.read("blobs/one")) + b"".join(new.read("blobs/two")) == b"labelslabels"
        server.stop()
        server.command = [word for word in server.command if word != f"{first.s3_key_id},{server.secret}"]
        server.command.remove("--auth-key")
        server.start()
        assert b"".join(new.read("blobs/one")) == b"labels"
        with refused_as("store_unavailable"):
            old.write("blobs/three", content)
