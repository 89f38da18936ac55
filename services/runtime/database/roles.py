"""PostgreSQL login roles, one for each service, which own nothing; `prepare` creates them and grants their rights.

**Conventions.** The role that prepares owns tables and triggers. `stone_api` and `stone_beat` change rows of every
table; they change no schema, and no trigger of an append-only table. A worker's role reads rows of every table without
secrets (`CREDENTIALS`), reads people and benchmarks, and writes the tables of its service. PostgreSQL checks foreign
keys and cascades with the owner's rights, so neither needs a grant.

Source: PostgreSQL 18, GRANT and "Privileges": SELECT … FOR KEY SHARE requires UPDATE on one column of the table.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from sqlalchemy import Connection, text

from services.runtime.database.migrate import schema_connection
from services.runtime.orm import User
from services.runtime.orm.base import Base
from services.runtime.settings import DatabaseSettings, Settings
from stone.errors import Refused

WORKERS = ("ingest", "labeler", "eval")
ROLES = ("api", "beat", *WORKERS)
"""The services that connect; the role of each is `stone_<service>`."""

CREDENTIALS = frozenset(
    {
        *("device_grants", "email_addresses", "external_identities", "idempotent_replies", "sign_in_addresses"),
        *("sign_in_guesses", "team_invitations", "tokens", "web_sessions", "webhooks"),
    }
)
"""Tables that hold credentials or their precursors; no worker reads them."""

PEOPLE = frozenset(
    {"notification_choices", "phase_teams", "profiles", "splits", "split_members", "team_members", "teams"}
)
BENCHMARKS = frozenset({"benchmarks", "phases", "reported"})
SCORING = frozenset({"activations", "ground_truths", "rescores", "score_parts", "scores", "scoring_ledger"})
READ_ONLY: Mapping[str, frozenset[str]] = {
    "ingest": PEOPLE | BENCHMARKS | SCORING | {"submissions"},
    "labeler": PEOPLE | BENCHMARKS | SCORING | {"submissions"},
    "eval": PEOPLE | {"artefacts", "label_sets", "labelled_frames", "recordings", "recording_files"},
}
"""Tables that the worker of a service reads and never writes."""

USER_COLUMNS = tuple(column.name for column in User.__table__.columns if column.name != "password_hash")
LOCK_COLUMNS = ("created_ns", "changed_ns")
"""A worker may update one of these columns of a table that it reads, so that it may lock a row."""


def name_of(service: str) -> str:
    """Return the login role of a service."""
    return f"stone_{service}"


def passwords_of(settings: DatabaseSettings) -> dict[str, str]:
    """Return the password of each service's role, empty if none is set.

    Raises `impossible_settings` if some services have a password and others have none.
    """
    given = {service: getattr(settings, f"{service}_password").get_secret_value() for service in ROLES}
    missing = [service for service in ROLES if not given[service]]
    if missing == list(ROLES):
        return {}
    if missing:
        names = ", ".join(f"STONE_DATABASE__{service.upper()}_PASSWORD" for service in missing)
        raise Refused("impossible_settings", f"some services have a database password, but these have none: {names}")
    return given


def ensure_roles(settings: Settings) -> bool:
    """Create the services' roles, set their passwords and grant their rights; return whether there are any.

    One transaction: no role loses a right during the change. Raises `impossible_settings`, also on SQLite.
    """
    passwords = passwords_of(settings.database)
    if not passwords:
        return False
    with schema_connection(settings) as connection:
        if connection.dialect.name != "postgresql":
            raise Refused("impossible_settings", "database roles require PostgreSQL; unset their passwords")
        for service, password in passwords.items():
            _create(connection, name_of(service), password)
            _grant(connection, service)
    return True


def _create(connection: Connection, role: str, password: str) -> None:
    known = connection.scalar(text("SELECT 1 FROM pg_roles WHERE rolname = :role"), {"role": role})
    verb = "ALTER" if known else "CREATE"
    driver: Any = connection.connection.driver_connection
    verifier = driver.pgconn.encrypt_password(password.encode(), role.encode(), b"scram-sha-256").decode()
    rights = "LOGIN NOSUPERUSER NOCREATEDB NOCREATEROLE NOINHERIT"
    connection.exec_driver_sql(f"{verb} ROLE {role} {rights} PASSWORD '{verifier}'")


def _grant(connection: Connection, service: str) -> None:
    role, tables = name_of(service), sorted(Base.metadata.tables)
    connection.exec_driver_sql(f"REVOKE ALL ON ALL TABLES IN SCHEMA public FROM {role}")
    connection.exec_driver_sql(f"REVOKE ALL (password_hash) ON users FROM {role}")
    connection.exec_driver_sql(f"GRANT SELECT ON alembic_version TO {role}")
    connection.exec_driver_sql(f"GRANT USAGE ON ALL SEQUENCES IN SCHEMA public TO {role}")
    if service not in WORKERS:
        _grant_on(connection, "SELECT, INSERT, UPDATE, DELETE", tables, role)
        return
    read = READ_ONLY[service]
    written = [name for name in tables if name not in {*CREDENTIALS, *read, User.__tablename__}]
    _grant_on(connection, f"SELECT ({', '.join(USER_COLUMNS)})", [User.__tablename__], role)
    _grant_on(connection, "SELECT", sorted(read), role)
    _grant_on(connection, "SELECT, INSERT, UPDATE, DELETE", written, role)
    for table in (User.__tablename__, *sorted(read)):
        for column in set(LOCK_COLUMNS) & set(Base.metadata.tables[table].columns.keys()):
            _grant_on(connection, f"UPDATE ({column})", [table], role)


def _grant_on(connection: Connection, rights: str, tables: Iterable[str], role: str) -> None:
    connection.exec_driver_sql(f"GRANT {rights} ON {', '.join(tables)} TO {role}")
