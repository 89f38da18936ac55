"""The platform under test: real server processes that stay up between rounds and can be killed.

**Conventions.** Short leases make recovery visible in seconds; a short grace lets garbage collection run between
rounds. The supervisor restarts a child killed on purpose without a growing pause. PostgreSQL flushes every commit to
the operating system before it answers: the process may be killed, but not the machine.
"""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from chaos.inputs import Inputs
from services.runtime.access.tokens import issue
from services.runtime.access.users import create_user
from services.runtime.embedded.child_process import Child
from services.runtime.embedded.supervisor import RunningPlatform, running_platform
from services.runtime.platform import Platform
from services.runtime.settings import (
    ApiSettings,
    DatabaseSettings,
    JobSettings,
    Settings,
    StoreSettings,
    UploadSettings,
    ViewingSettings,
)
from stone_client.credentials import Server
from testing.servers.postgres import PostgresServer, running_postgres
from testing.servers.s3 import S3Server, running_s3

WORKERS = 2
BUCKET = "chaos"
JOBS = JobSettings(lease_s=2.0, heartbeat_s=0.4, progress_s=0.2, sweep_s=0.25)
STORE = StoreSettings(grace_s=5.0)
UPLOADS_IN_STORE = UploadSettings(backend="store", part_bytes=2**20)  # a short recording then has several parts
VIEWING = ViewingSettings(makes_playback=False)  # a round ends with the requested run
API = ApiSettings(port=0, requests_per_minute=10**6)
SCOPES = ("read", "upload", "submit")
DAY_S = 86_400.0


@dataclass(frozen=True)
class RoundOwner:
    """A user of one round, and the server for their requests."""

    user_id: str
    server: Server


@dataclass(frozen=True)
class PlatformUnderTest:
    """A running platform; `postgres` is its database and `s3` its store, if it has these servers."""

    running: RunningPlatform
    inputs: Inputs
    postgres: PostgresServer | None = None
    s3: S3Server | None = None

    @property
    def platform(self) -> Platform:
        return self.running.platform

    @property
    def evidence(self) -> Path:
        """The file with the reason why the folder stays."""
        return self.platform.settings.root / "violations.txt"

    @property
    def is_kept(self) -> bool:
        return self.evidence.exists()

    def keep(self, why: str) -> None:
        """Keep the folder when the platform is closed."""
        self.evidence.write_text(why, "utf-8")

    def child(self, name: str) -> Child:
        """Return redis, worker, api or sweeper."""
        return next(child for child in self.running.children if child.program.name == name)

    def kill(self, name: str) -> None:
        """kill −9 the child with all processes of its group; the supervisor starts it again."""
        child = self.child(name)
        child.forgive()
        os.killpg(child.pid, signal.SIGKILL)

    def welcome(self, name: str) -> RoundOwner:
        """Create a curator with a token."""
        with self.platform.database.transaction() as session:
            user = create_user(session, name, "curator")
            return RoundOwner(user.id, Server(self.running.url, issue(session, user, "chaos", SCOPES, DAY_S)))


@contextmanager
def platform_under_test(
    folder: Path,
    inputs: Inputs,
    report: Callable[[str], None],
    *,
    on_postgres: bool,
    on_s3: bool = False,
    uploads_in_store: bool = False,
) -> Iterator[PlatformUnderTest]:
    """Run a platform in `folder`, drained at the end; delete the folder unless it must stay or the block raised."""
    with ExitStack() as stack:
        postgres = stack.enter_context(_postgres(folder)) if on_postgres else None
        url = postgres.url() if postgres else ""
        s3 = stack.enter_context(_s3(folder)) if on_s3 else None
        settings = Settings(
            data_folder=folder,
            workers=WORKERS,
            database=DatabaseSettings(url),
            jobs=JOBS,
            store=replace(s3.settings(BUCKET), grace_s=STORE.grace_s) if s3 else STORE,
            uploads=UPLOADS_IN_STORE if uploads_in_store else UploadSettings(),
            api=API,
            viewing=VIEWING,
        )
        target = PlatformUnderTest(stack.enter_context(running_platform(settings, report)), inputs, postgres, s3)
        yield target
    if not target.is_kept:
        shutil.rmtree(folder)


@contextmanager
def _postgres(folder: Path) -> Iterator[PostgresServer]:
    """Run a server that stops as in a crash (an immediate shutdown); its cluster stays with the folder."""
    with running_postgres(synchronous_commit="on") as server:
        server.stop_signal = signal.SIGQUIT
        yield server
        server.stop()
        shutil.copytree(server.folder / "cluster", folder / "postgres")


@contextmanager
def _s3(folder: Path) -> Iterator[S3Server]:
    """Run a server whose bucket stays with the folder."""
    with running_s3() as server:
        yield server
        shutil.copytree(server.buckets / BUCKET, folder / BUCKET)
