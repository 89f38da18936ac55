"""`stone serve` as a user runs it: a process with a data folder, a URL once it is ready, and children.

**Conventions.** Its configuration folder lies beside the data, so that no test touches this user's.
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil

from services.runtime.store.free_space import NO_RESERVE
from stone_client.api import Api
from stone_client.credentials import Server
from testing.signals import hear_signals

STONE = (str(Path(sys.executable).parent / "stone"),)
RESERVE = "STONE_STORE__RESERVE_BYTES"
PATIENCE_S = 300.0


@dataclass(frozen=True)
class Serving:
    """A running platform. `output` is the file of its stderr."""

    process: subprocess.Popen[str]
    url: str
    data: Path
    output: Path

    @property
    def token(self) -> str:
        return (self.data / "local-token").read_text().strip()

    def api(self) -> Api:
        return Api(Server(self.url, self.token))

    def descendants(self) -> list[psutil.Process]:
        """Return every process below the supervisor, including the worker's."""
        return list(psutil.Process(self.process.pid).children(recursive=True))

    def child(self, name: str) -> psutil.Process:
        """Return the child whose command line contains `name`."""
        children = psutil.Process(self.process.pid).children()
        return next(process for process in children if any(name in part for part in process.cmdline()))

    def kill_9(self) -> None:
        """End the supervisor as in a power cut, and wait until all its processes have ended."""
        below = self.descendants()
        self.process.kill()
        self.process.wait()
        until(lambda: not any(is_alive(process) for process in below))

    def stop(self) -> int:
        """Drain it and return its exit code."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait(PATIENCE_S)


def environment(data: Path, **extra: str | None) -> Mapping[str, str]:
    """Return this environment, with a configuration folder beside `data` and only `RESERVE` of the platform's settings.

    So the free space of this machine's disk cannot affect a test. An `extra` of None is removed.
    """
    kept = {name: value for name, value in os.environ.items() if not name.startswith("STONE_")}
    ours = {RESERVE: str(NO_RESERVE), "STONE_CONFIG_HOME": str(data.parent / "configuration"), **extra}
    return {**kept, **{name: value for name, value in ours.items() if value is not None}}


@contextmanager
def serving(data: Path, command: Sequence[str] = STONE, **extra: str | None) -> Iterator[Serving]:
    """Yield a platform on `data` once it is ready; end it, in order if it still runs. `command` is that of `stone`."""
    output = data.parent / "serve.stderr"
    with output.open("a") as stderr:
        process = subprocess.Popen(
            [*command, "serve", "--data", str(data), "--port", "0", "--workers", "2", "--json"],
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
            env=environment(data, **extra),
            preexec_fn=hear_signals,
        )
    try:
        assert process.stdout is not None
        with process.stdout:
            line = process.stdout.readline()
        assert line, output.read_text()
        yield Serving(process, json.loads(line)["url"], data, output)
    finally:
        if process.poll() is None:
            process.terminate()
            process.wait(PATIENCE_S)


def until(claim: Callable[[], bool], patience_s: float = PATIENCE_S) -> None:
    """Wait until the claim is true; fail after `patience_s`."""
    end = time.monotonic() + patience_s
    while not claim():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.05)


def is_alive(process: psutil.Process) -> bool:
    """Return whether it runs; a zombie does not."""
    with suppress(psutil.NoSuchProcess):  # it may end between the two calls
        return bool(process.is_running() and process.status() != psutil.STATUS_ZOMBIE)
    return False
