"""The embedded platform as a context manager, which starts and ends all its processes.

**Conventions.** The order is: lock the folder, bind the port, start Redis, upgrade the database, queue interrupted jobs
again, create keys, then start API, worker and sweeper. A thread restarts dead children. The end is the reverse: the
platform accepts no more requests, the worker may finish for a while, its unfinished jobs are queued again, and Redis
stops last. A second start resumes.
"""

import os
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from http import HTTPStatus
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from threading import Event, Thread
from typing import Any

from pydantic import SecretStr

from services.runtime.database.ballast import Ballast
from services.runtime.database.migrate import upgrade
from services.runtime.embedded.child_process import Child, Program, ReportCallback, fate_of, last_words
from services.runtime.embedded.errors import StartFailedError
from services.runtime.embedded.first_start import FirstStartKeys, ensure_keys
from services.runtime.embedded.listen_socket import close, hold_folder, listen, local_host, reached_at
from services.runtime.embedded.redis_child import Pulse, start_redis
from services.runtime.jobs.broker_app import QUEUES
from services.runtime.jobs.lease_sweep import CRASHED, STOPPED, give_back_running
from services.runtime.jobs.worker_presence import forget_silent
from services.runtime.platform import Platform, open_platform
from services.runtime.processes.private_files import keep_private, open_data_folder
from services.runtime.settings import ApiSettings, Settings
from services.runtime.telemetry.descriptors import raise_descriptor_limit

READY_S = 180.0  # on a busy machine the imports alone take a minute
LOOK_S = 0.2


@dataclass(frozen=True)
class RunningPlatform:
    """A running platform: its address and its keys."""

    platform: Platform
    keys: FirstStartKeys
    _watched: "SupervisedChildren"

    @property
    def children(self) -> tuple[Child, ...]:
        """Redis, worker, API, sweeper."""
        return self._watched.children

    @property
    def url(self) -> str:
        return self.platform.settings.api.url

    @property
    def logs(self) -> Path:
        return logs_of(self.platform.settings)

    def wait_until_ready(self) -> None:
        """Wait for the first answer; from then on dead children are restarted. Raises `StartFailedError`."""
        _, _, api, sweeper = self.children
        _wait_until_ready(self.platform.settings.api, (api, sweeper))
        self._watched.start()


def logs_of(settings: Settings) -> Path:
    """Return the folder of the children's log files."""
    return settings.root / "logs"


@contextmanager
def running_platform(
    settings: Settings, report: ReportCallback = lambda line: None, *, is_awaited: bool = True
) -> Iterator[RunningPlatform]:
    """Yield the platform when it is ready; drain and end it afterwards. `told` is called with the children's events.

    With `is_awaited=False`, it is yielded immediately; call `wait_until_ready` later. Raises `already_serving`,
    `PortTakenError`, `redis_missing`, `StartFailedError`.
    """
    raise_descriptor_limit()  # the children inherit it
    with ExitStack() as stack:
        stack.callback(os.umask, keep_private())
        lock = stack.enter_context(hold_folder(settings.root))
        if warning := open_data_folder(settings.root):
            report(f"{warning.code}: {warning}")
        listener = listen(settings.api)
        stack.callback(close, listener)
        broker = start_redis(settings.root / "redis", logs_of(settings), report)
        stack.callback(broker.child.kill)
        settings = _completed(settings, broker.url, reached_at(settings.api, listener).url, listener.getsockname()[1])
        upgrade(settings)
        platform = open_platform(settings)
        stack.callback(platform.database.close)
        keys = _prepare(platform, report)
        if platform.database.is_sqlite:
            Ballast(settings).make()
        programs = (
            worker_program(settings),
            api_program(settings, listener.fileno()),
            sweeper_program(settings),
        )
        worker, api, sweeper = (Child(program, logs_of(settings), report) for program in programs)
        watched = SupervisedChildren((broker.child, worker, api, sweeper), report, Pulse(broker, report))
        stack.callback(watched.kill)
        for child in (worker, api, sweeper):
            child.start()
        running = RunningPlatform(platform, keys, watched)
        if is_awaited:
            running.wait_until_ready()
        lock.say(settings.api.url)
        try:
            yield running
        finally:
            watched.stop()
            close(listener)
            _drain(platform, (api, sweeper), worker, report)
            broker.child.stop()


def _completed(settings: Settings, broker_url: str, url: str, port: int) -> Settings:
    broker = replace(settings.broker, url=broker_url)
    return settings.model_copy(update={"broker": broker, "api": replace(settings.api, url=url, port=port)})


def _prepare(platform: Platform, report: ReportCallback) -> FirstStartKeys:
    """Queue the interrupted jobs of an earlier platform and create the keys, before any worker starts.

    A SQLite database belongs to this platform alone; a database server may have other workers, whose jobs the sweeper
    recovers.
    """
    if platform.database.is_sqlite:
        interrupted = give_back_running(platform, CRASHED, is_counted=True)
        forget_silent(platform, older_than_s=0.0)
        if interrupted:
            report(f"{interrupted} interrupted job(s) queued again")
    return ensure_keys(platform)


def _wait_until_ready(api: ApiSettings, needed: tuple[Child, ...]) -> None:
    until_s = time.monotonic() + READY_S
    while not _answers((local_host(api.host), api.port)):
        for child in needed:
            if child.exit_code is not None:
                raise StartFailedError(child.program.name, fate_of(child.exit_code), child.log, last_words(child.log))
        if time.monotonic() > until_s:
            raise StartFailedError(
                "api", f"was not ready within {READY_S:g} s", needed[0].log, last_words(needed[0].log)
            )
        time.sleep(0.05)


def _answers(address: tuple[str, int]) -> bool:
    """Return whether `/readyz` succeeds; the request ignores proxies of the environment."""
    connection = HTTPConnection(*address, timeout=5.0)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == HTTPStatus.OK
    except (HTTPException, OSError):
        return False
    finally:
        connection.close()


def _drain(platform: Platform, quick: tuple[Child, ...], worker: Child, report: ReportCallback) -> None:
    """Stop all children at once; the worker has longest. Its unfinished jobs are queued for the next start."""
    for child in (*quick, worker):
        child.ask_to_stop()
    until_s = time.monotonic() + worker.program.stop_s
    for child in quick:
        child.stop()
    if not worker.stop(until_s - time.monotonic()):
        report(f"worker did not finish within {worker.program.stop_s:g} s and was killed")
    if platform.database.is_sqlite:
        interrupted = give_back_running(platform, STOPPED, is_counted=False)
        if interrupted:
            report(f"{interrupted} unfinished job(s) resume at the next start")


class SupervisedChildren:
    """Children that a thread restarts when they die; Redis also if it runs without answering.

    Processes started by the thread die with it, so it stays, idle, until all of them have ended.
    """

    def __init__(self, children: tuple[Child, ...], report: ReportCallback, pulse: Pulse) -> None:
        self.children = children
        self._pulse = pulse
        self._report = report
        self._leaving, self._idle, self._released = Event(), Event(), Event()
        self._thread = Thread(target=self._watch, name="supervisor", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """Stop supervising; the children then belong to the caller again."""
        self._leaving.set()
        if self._thread.is_alive():
            self._idle.wait()

    def kill(self) -> None:
        """End all running children, and the thread."""
        self.stop()
        for child in self.children:
            child.kill()
        self._released.set()

    def _watch(self) -> None:
        while not self._leaving.wait(LOOK_S):
            self._pulse.look(time.monotonic())
            for child in self.children:
                self._revive(child)
        self._idle.set()
        self._released.wait()

    def _revive(self, child: Child) -> None:
        try:
            child.revive()
        except OSError as error:  # no process, memory or disk available: the next check tries again
            self._report(f"{child.program.name} could not be started: {error}")


# Command lines, environments and stop timeouts of the child processes. Every process reads its settings from the
# environment, as in a cluster; only the API's listening socket is passed otherwise. A worker has one thread per
# library, because jobs provide its parallelism. It has a lower CPU priority, because pages must respond within a
# second, while labels take minutes.


DRAIN_S = 15.0
WORKER_NICENESS = 5  # a third of the share of others
REPLIES_S = 5
ONE_THREAD = {
    name: "1"
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "OMP_THREAD_LIMIT")
}


def environment_of(settings: Settings) -> dict[str, str]:
    """Return this process's environment with `settings` in place of its `STONE_*` variables."""
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("STONE_")}
    named: dict[str, str] = {}
    for name in type(settings).model_fields:
        named |= _named(f"STONE_{name.upper()}", getattr(settings, name))
    return {**inherited, **named, "STONE_DATA_FOLDER": str(settings.root), "PYTHONUNBUFFERED": "1"}


def api_program(settings: Settings, descriptor: int) -> Program:
    """Return uvicorn on a socket that is already listening."""
    argv = _python("services.runtime.embedded.api_process", str(descriptor), str(REPLIES_S))
    return Program("api", argv, environment_of(settings), settings.root, REPLIES_S + 3.0, (descriptor,))


def worker_program(settings: Settings) -> Program:
    """Return one Celery worker for all queues; it forks `settings.concurrency` processes."""
    argv = _python("services.runtime.processes.worker", *QUEUES)
    environment = environment_of(settings) | ONE_THREAD
    return Program("worker", argv, environment, settings.root, DRAIN_S, niceness=WORKER_NICENESS)


def sweeper_program(settings: Settings) -> Program:
    argv = _python("services.maintenance.sweeper")
    return Program("sweeper", argv, environment_of(settings), settings.root, 5.0)


def _python(module: str, *arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-P", "-m", module, *arguments)


def _named(name: str, value: Any) -> Mapping[str, str]:
    if is_dataclass(value) and not isinstance(value, type):
        parts = [_named(f"{name}__{part.name.upper()}", getattr(value, part.name)) for part in fields(value)]
        return {key: text for part in parts for key, text in part.items()}
    if isinstance(value, SecretStr):
        return {name: value.get_secret_value()}
    return {name: str(value)}
